"""The wheel with kernels and the one without: their contents, and an attack by each in a foreign folder."""

import os
import subprocess
import sys
import sysconfig
from pathlib import Path
from zipfile import ZipFile

import pytest

from tests.packages import FOLDERS

pytestmark = pytest.mark.integration

ROOT = Path(__file__).parents[2]
KERNELS = {f"scene_attack/rendering/kernels/kernels-{level}.so" for level in ("v3", "v4")}
ATTACK = """
import sys
import torch
import scene_attack as sa
from scene_attack.rendering.kernels import compiled, levels

assert sa.__file__.startswith(sys.argv[1]), sa.__file__
module = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(192, 3))
target = sa.target(module, preprocessing=sa.Preprocessing(input_size=(8, 8)))
scene = sa.Scene(camera=sa.Camera(size=(32, 32)), objects=[sa.Object(mesh="primitive/sphere")])
result = sa.attack(scene, target, sa.FGSM(renderer="torch", steps=1))
print(compiled.backend(), *[item.why for item in result.plan.items if item.what == "compiled kernels"])
"""


def built(folder: Path, **environ: str) -> Path:
    """The wheel that the checkout gives with this environment."""
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", str(folder), "."]
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ | environ, capture_output=True, text=True, check=False, timeout=600
    )
    assert done.returncode == 0, done.stdout + done.stderr
    [wheel] = folder.iterdir()
    return wheel


def contents(wheel: Path) -> set[str]:
    """The files of a wheel, less those that describe it."""
    with ZipFile(wheel) as file:
        return {name for name in file.namelist() if ".dist-info/" not in name}


def attacked(wheel: Path, folder: Path) -> str:
    """What an attack of the installed wheel printed, in a folder where a user's own files have ordinary names."""
    site, own = folder / "site", folder / "own"
    install = ["-m", "pip", "install", "-q", "--no-deps", "--no-index", "--target", str(site), str(wheel)]
    subprocess.run([sys.executable, *install], check=True, capture_output=True, timeout=300)
    (own / "api").mkdir(parents=True)
    (own / "services").mkdir()
    for name in ("client.py", "worker.py", "api/__init__.py", "services/__init__.py"):
        (own / name).write_text("raise SystemExit('this is a file of the user')\n")
    # -S: the environment's own site-packages would bring the checkout; the path brings its packages alone.
    environ = os.environ | {"PYTHONPATH": os.pathsep.join([str(site), sysconfig.get_path("purelib")]), "PATH": str(own)}
    done = subprocess.run(
        [sys.executable, "-S", "-c", ATTACK, str(site)],
        cwd=own, env=environ, capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1]


def test_the_wheel_has_our_packages_whole_and_its_kernels_run_without_a_compiler(tmp_path: Path) -> None:
    wheel = built(tmp_path / "dist")
    assert wheel.name.endswith("-py3-none-linux_x86_64.whl")
    assert wheel.stat().st_size < 60_000_000
    listed = subprocess.run(
        ["git", "ls-files", *(f"*/{name}/*" for name in FOLDERS)], cwd=ROOT, capture_output=True, text=True, check=True
    )
    ours = {name.partition("/")[2] for name in listed.stdout.splitlines() if "/kernels/src/" not in name}
    assert contents(wheel) == ours | KERNELS
    assert {name.partition("/")[0] for name in ours} == set(FOLDERS)
    assert attacked(wheel, tmp_path).startswith("native v")


def test_without_a_compiler_the_wheel_is_pure_and_torch_computes(tmp_path: Path) -> None:
    wheel = built(tmp_path / "dist", CXX="/nonexistent")
    assert wheel.name.endswith("-py3-none-any.whl")
    assert not KERNELS & contents(wheel)
    printed = attacked(wheel, tmp_path)
    assert printed.startswith("torch torch shades")
    assert "v3 are not in this installation, which was built without a C++ compiler" in printed
