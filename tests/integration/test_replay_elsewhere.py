"""An export is replayed on another machine: a fresh process with a HOME of its own and nothing in its cache."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from markdown_it import MarkdownIt
from markdown_it.token import Token
from PIL import Image
from safetensors.torch import save_file

from scene_attack.export.bundle import into_folder, write_bundle
from scene_attack.runs.execute import execute
from scene_attack.runs.spec import parse
from scene_attack.scenes.bundle import About, Bundle
from scene_attack.scenes.library import Library
from scene_attack.targets.architectures import ARCHITECTURES, Architecture
from scene_attack_service.settings import Settings
from tests.unit.client.command_line import cli

pytestmark = pytest.mark.integration

CAMERA = {"size": [64, 64]}
MAP = (
    b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n" + bytes((128, 90, 40, 129)) * 16 + bytes((9, 9, 99, 130)) * 16
)
HOSTILE = "ball [x](javascript:alert(1)) <img src=x onerror=alert(1)> | `a` **b** &lt; \\"
NETWORK = "efficientnet-lite0"
LABELS = "first\nsecond\nthird\n"


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Library]:
    threads = torch.get_num_threads()
    torch.set_num_threads(Settings().threads)  # part of what decides the bits
    yield Library(Settings().cache_dir, tmp_path_factory.mktemp("data"))
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The colleague's. All replays share it: what they leave in it is what OpenGL can do."""
    return tmp_path_factory.mktemp("home")


def elsewhere(home: Path, *arguments: str, **environ: str) -> "subprocess.CompletedProcess[str]":
    ours = {name: value for name, value in os.environ.items() if not name.startswith(("SCENE_ATTACK_", "XDG_"))}
    mine = Settings()
    ours["SCENE_ATTACK_THREADS"] = str(mine.threads)  # part of what decides the bits
    command = [sys.executable, "-m", "scene_attack", *arguments]
    return subprocess.run(
        command, env=ours | {"HOME": str(home)} | environ, capture_output=True, text=True, check=False, timeout=300
    )


def reproduced(home: Path, export: Path) -> None:
    """The export gives the same image and the same answer, and the cache has no mesh and no map, before and after."""
    done = elsewhere(home, "replay", str(export), "--json")
    assert done.returncode == 0, done.stdout + done.stderr
    again = json.loads(done.stdout)
    assert (again["pixels_differing"], again["same_backend"], again["reproduced"]) == (0, True, True)
    assert again["replayed"] == again["stored"]
    cache = home / ".cache/scene-attack"
    assert not [name for name in ("furniture", "environments", "meshes") if (cache / name).exists()]
    assert not (home / ".local/share/scene-attack/assets").exists()


def textured_ball() -> Bundle:
    """A ball with a material and a texture in files of their own, lying on its side."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    picture = BytesIO()
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (16, 16, 3), dtype=np.uint8)).save(picture, "png")
    lines = ["mtllib ball.mtl", "usemtl skin"]
    lines += [f"v {x:.5f} {y:.5f} {z / 2:.5f}\nvt {(x + 1) / 2:.5f} {(y + 1) / 2:.5f}" for x, y, z in ball.vertices]
    lines += ["f " + " ".join(f"{corner + 1}/{corner + 1}" for corner in face) for face in ball.faces]
    others = {"ball.mtl": b"newmtl skin\nKd 1 1 1\nmap_Kd ../maps/skin.png\n", "../maps/skin.png": picture.getvalue()}
    return Bundle("obj", "\n".join(lines).encode(), others, About(title=HOSTILE, up="z", credit=HOSTILE))


def scenes(library: Library) -> dict[str, dict[str, Any]]:
    ball, light = library.add(textured_ball()).name, library.add(Bundle("hdr", MAP, {})).name
    # chair2 is the second model of its name, which a library of it alone would call chair.
    return {
        "uploads": {"objects": [{"mesh": ball}], "lights": {"environment": {"map": light}}},
        "furniture": {"objects": [{"mesh": "furniture/chair2"}, {"mesh": "primitive/cube", "scale": 0.4}]},
    }


@pytest.mark.parametrize(
    ("name", "attack"),
    [
        ("uploads", {"renderer": "torch"}),
        ("furniture", {"renderer": "pyrender", "delta": 1e-2, "coordinates": 8}),
    ],
    ids=["uploads", "furniture"],
)
def test_an_export_is_replayed_from_its_folder_alone(
    library: Library, home: Path, tmp_path: Path, name: str, attack: dict[str, Any]
) -> None:
    scene = scenes(library)[name] | {"camera": CAMERA}
    spec = parse({"scene": scene, "attack": attack | {"steps": 1}})
    done, export = tmp_path / "done", tmp_path / "export"
    execute(spec, done, library)
    write_bundle({file.name: file.read_bytes for file in done.iterdir()}, library, into_folder(export))
    shutil.rmtree(done)
    reproduced(home, export)
    if name == "uploads":
        shown = MarkdownIt().enable("table").parse((export / "README.md").read_text())
        texts = [plain_text(token) for token in shown if token.type == "inline" and "ball" in token.content]
        title, finding, credit = (text for text in texts if HOSTILE in text)
        assert title == f"{HOSTILE}: torch combined fgsm against {NETWORK}"
        assert finding.startswith(f"material of {HOSTILE}: ")
        assert credit == HOSTILE


def plain_text(inline: Token) -> str:
    """The text of a line of Markdown; fails if it has a link, an image, HTML or any other markup."""
    assert {one.type for one in inline.children or ()} <= {"text", "text_special"}, inline.content
    return "".join(one.content for one in inline.children or ())


def test_a_changed_upload_is_not_taken_for_the_one_that_was_sent(library: Library, tmp_path: Path) -> None:
    scene = scenes(library)["uploads"] | {"camera": CAMERA}
    done, export = tmp_path / "done", tmp_path / "export"
    execute(parse({"scene": scene, "attack": {"renderer": "image", "steps": 1}}), done, library)
    write_bundle({file.name: file.read_bytes for file in done.iterdir()}, library, into_folder(export))
    [mesh] = export.glob("assets/uploads/*/**/mesh.obj")
    mesh.write_bytes(mesh.read_bytes().replace(b"v 0.5", b"v 0.6"))
    refused = cli("replay", str(export))
    assert refused.returncode == 2
    assert "are not those that were uploaded" in refused.stderr
    mesh.unlink()
    mesh.symlink_to(tmp_path / "done" / "result.json")
    refused = cli("replay", str(export))
    assert refused.returncode == 2
    assert "mesh.obj is neither a file nor a folder" in refused.stderr


def test_a_network_of_ones_own_is_asked_for_by_its_file_and_its_place(home: Path, tmp_path: Path) -> None:
    torch.manual_seed(0)
    architecture = ARCHITECTURES["resnet34"]
    assert isinstance(architecture, Architecture)
    mine, export = tmp_path / "mine/my-net", tmp_path / "export"
    mine.mkdir(parents=True)
    save_file(architecture.build(3).state_dict(), mine / "model.safetensors")
    card = {"labels": "kinds.txt", "architecture": "resnet34", "preprocessing": {"input_size": [64, 64]}}
    (mine / "card.json").write_text(json.dumps(card))
    (mine / "kinds.txt").write_text(LABELS)
    scene = {"objects": [{"mesh": "primitive/sphere"}], "camera": CAMERA}
    spec = {"scene": scene, "target": {"name": "my-net"}, "attack": {"renderer": "image", "steps": 1}}
    (tmp_path / "spec.json").write_text(json.dumps(spec))
    where = {
        "SCENE_ATTACK_CACHE": str(Settings().cache_dir),
        "SCENE_ATTACK_DATA": str(tmp_path / "data"),
        "SCENE_ATTACK_TARGETS": str(mine.parent),
    }
    for command in (("run", str(tmp_path / "spec.json")), ("export", str(tmp_path / "done"))):
        out = tmp_path / "done" if command[0] == "run" else export
        done = elsewhere(home, *command, "--out", str(out), **where)
        assert done.returncode == 0, done.stderr

    model = (mine / "model.safetensors").read_bytes()
    digest, place = sha256(model).hexdigest(), export / "targets"
    said = (
        f"the weights of the network 'my-net' are not in the export: put model.safetensors, whose SHA-256 is {digest}"
    )
    assert f"- {said}, into targets/my-net.".replace("_", "\\_") in (export / "README.md").read_text()
    assert {path.name for path in (place / "my-net").iterdir()} == {"card.json", "kinds.txt"}
    missing = elsewhere(home, "replay", str(export))
    assert missing.returncode == 2
    assert f"directory: {said}, into {place}/my-net" in " ".join(missing.stderr.split())

    save_file(architecture.build(3).state_dict(), place / "my-net/model.safetensors")
    other = elsewhere(home, "replay", str(export))
    assert other.returncode == 2
    assert f"the result is of those with {digest}" in other.stderr

    (place / "my-net/model.safetensors").write_bytes(model)
    reproduced(home, export)

    # A network of this name on the colleague's machine does not take the place of the one that was put in.
    save_file(architecture.build(3).state_dict(), mine / "model.safetensors")
    done = elsewhere(home, "replay", str(export), SCENE_ATTACK_TARGETS=str(mine.parent))
    assert done.returncode == 0, done.stderr
