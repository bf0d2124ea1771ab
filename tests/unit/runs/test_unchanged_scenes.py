"""Scenes without a floor, without metallic and roughness: their requests, digests and images are what they always were.

`unchanged_scenes.json` was written before these options existed, by

    python -m tests.unit.runs.test_unchanged_scenes > tests/unit/runs/unchanged_scenes.json

The digests of requests are later: a request states `target.ask` where it stated `target.question`.
The exact images as they are saved, in 8 bits, are compared where the same OpenGL draws them; the bits of the floats,
where the kernels are the same too. A driver's or a processor's arithmetic is part of them.
"""

import hashlib
import json
import re
import tempfile
from pathlib import Path
from typing import Any

import pytest

from benchmarks.gltf_models import MODELS
from scene_attack.rendering.color import to_bytes
from scene_attack.rendering.factory import build
from scene_attack.rendering.kernels import compiled
from scene_attack.runs.spec import digest, parse
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import canonical_json, resolve
from scene_attack_service.settings import Settings
from tests.unit.scenes.old_uploads import add_as_before

PINNED = Path(__file__).with_name("unchanged_scenes.json")
SMALL = {"size": (48, 64), "distance": 2.4}
LIGHTS = {
    "points": [{"energy": 12, "position": (1, 2, 1)}],
    "directional": [{"energy": 1, "direction": (0, -1, -1)}],
    "spots": [{"energy": 20, "position": (0, 2, 2), "direction": (0, -1, -1)}],
}
SCENES: dict[str, dict[str, Any]] = {
    "one cube": {"objects": [{"mesh": "primitive/cube"}], "camera": SMALL},
    "two materials": {
        "objects": [
            {"mesh": "primitive/sphere", "material": "plastic", "color": (0.8, 0.2, 0.1), "translation": (-0.4, 0, 0)},
            {"mesh": "primitive/cylinder", "material": "brushed-metal", "rotation": (0.3, 0.2, 0), "scale": 0.6},
        ],
        "camera": SMALL,
    },
    "three kinds of light": {"objects": [{"mesh": "primitive/torus"}], "camera": SMALL, "lights": LIGHTS},
    "a textured mesh": {
        "objects": [{"mesh": "furniture/soccer-ball"}],
        "camera": SMALL | {"viewer": "perspective"},
        "ground": (0.2, 0.4, 0.6),
    },
    "a file's materials": {
        "objects": [{"mesh": "sha256:" + hashlib.sha256(MODELS["two materials"]()).hexdigest()}],
        "camera": SMALL,
    },
}
RENDERERS = ("pyrender", "torch")


def library(directory: Path) -> Library:
    add_as_before(directory / "assets", MODELS["two materials"](), "glb")
    return Library(Settings().cache_dir, directory)


def described(name: str, assets: Library) -> dict[str, str]:
    """The digests of a scene's request, canonical description and contents."""
    spec = parse({"scene": SCENES[name]})
    return {
        "request": digest(spec),
        "canonical": hashlib.sha256(canonical_json(spec.scene).encode()).hexdigest(),
        "scene": resolve(spec.scene, assets).sha256,
    }


def drawn(name: str, renderer: str, assets: Library) -> dict[str, str]:
    """The digests of the bits of a scene's images, the OpenGL that drew them and the kernels that shaded them."""
    made = build(resolve(parse({"scene": SCENES[name]}).scene, assets), renderer)
    images = {"planned": made.render({})[0], "exact": made.exact().render({})[0]}
    images["saved"] = to_bytes(images["exact"])
    bits = {kind: hashlib.sha256(image.cpu().numpy().tobytes()).hexdigest() for kind, image in images.items()}
    return bits | {"opengl": opengl(made.backend), "kernels": compiled.backend()}


def opengl(backend: str) -> str:
    """The driver that draws the geometry, as a backend names it."""
    found = re.search(r"(egl|osmesa) [^;]+; OpenGL [^;]+", backend)
    assert found is not None
    return found[0]


@pytest.fixture(scope="module")
def assets(tmp_path_factory: pytest.TempPathFactory) -> Library:
    return library(tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def pinned() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(PINNED.read_text("utf-8"))
    return found


@pytest.mark.parametrize("name", SCENES)
def test_digests_are_what_they_were(name: str, assets: Library, pinned: dict[str, Any]) -> None:
    assert described(name, assets) == pinned["digests"][name]


@pytest.mark.parametrize("renderer", RENDERERS)
@pytest.mark.parametrize("name", SCENES)
def test_images_are_what_they_were(name: str, renderer: str, assets: Library, pinned: dict[str, Any]) -> None:
    before, now = pinned["images"][name][renderer], drawn(name, renderer, assets)
    if now["opengl"] != before["opengl"]:
        pytest.skip(f"the pinned images were drawn by {before['opengl']}")
    assert now["saved"] == before["saved"]
    if now["kernels"] == before["kernels"]:
        assert now == before


def main() -> None:
    """Prints the digests of the code at hand."""
    with tempfile.TemporaryDirectory() as directory:
        assets = library(Path(directory))
        found = {
            "digests": {name: described(name, assets) for name in SCENES},
            "images": {name: {kind: drawn(name, kind, assets) for kind in RENDERERS} for name in SCENES},
        }
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
