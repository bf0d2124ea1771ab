"""The plug-in: it is refused where Blender is not installed, and it can be left out."""

import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.declaration import RENDERERS
from scene_attack.runs.prepare import prepare
from scene_attack.runs.spec import parse
from scene_attack_blender import plugin
from tests.unit.jobs.small import LIBRARY, SPHERE

pytestmark = pytest.mark.slow


PINS = Path(__file__).parents[3] / "requirements-renderers.txt"
REQUEST = {"scene": SPHERE, "attack": {"renderer": "blender"}}


def test_the_declaration_imports_neither_torch_nor_bpy() -> None:
    code = "import sys, scene_attack_blender.plugin; print({'torch', 'bpy', 'numpy'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def no_package(_: str) -> str:
    raise metadata.PackageNotFoundError


@pytest.mark.parametrize(
    ("version", "python", "words"),
    [
        (no_package, (3, 11), r'the package bpy 5\.0, which is not installed: pip install --no-deps "bpy==5\.0\.\*"'),
        (lambda _: "4.5.1", (3, 11), r"the package bpy 5\.0, which is there as 4\.5\.1: pip install"),
        (lambda _: "5.01.0", (3, 11), r"the package bpy 5\.0, which is there as 5\.01\.0: pip install"),
        (no_package, (3, 13), r"Python 3\.11, which its package bpy 5\.0 is made for, and this is "),
    ],
)
def test_what_is_missing_is_said_before_anything_is_rendered(
    monkeypatch: pytest.MonkeyPatch, version: object, python: tuple[int, int], words: str
) -> None:
    monkeypatch.setattr(plugin, "version", version)
    monkeypatch.setattr(plugin, "PYTHON", python)
    with pytest.raises(InvalidRequest, match=rf"^attack\.renderer: the renderer blender needs {words}"):
        prepare(parse(REQUEST), LIBRARY)


def test_left_out_it_is_unknown_and_all_else_works() -> None:
    code = (
        "from scene_attack.runs.environment import options_to_run\noptions_to_run()\n"
        "from scene_attack.rendering.declaration import RENDERERS\nprint(*RENDERERS)"
    )
    environment = {"PATH": "/usr/bin:/bin", "SCENE_ATTACK_WITHOUT_PLUGINS": "blender"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [name for name in RENDERERS if name != "blender"]


def test_the_tests_have_the_release_of_blender_that_is_asked_for() -> None:
    [line] = [line for line in PINS.read_text().splitlines() if line.startswith("bpy")]
    need = Requirement(line.removesuffix(" \\"))
    assert need.marker is not None
    assert str(need.specifier).startswith(f"=={plugin.RELEASE}.")
    assert need.marker.evaluate(
        {"python_full_version": "3.11.9", "platform_machine": "x86_64", "sys_platform": "linux"}
    )
    assert not need.marker.evaluate({"python_full_version": "3.12.0"})
