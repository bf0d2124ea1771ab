"""The export of a job, given as the source of another, is the same job to the pixel: the scene before the attack as the
original image shows it, and the scene after it as the attacked image does.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from scene_attack.export.bundle import Finished, read_finished
from scene_attack.rendering.color import to_bytes
from scene_attack.rendering.factory import build
from scene_attack.runs.execute import execute
from scene_attack.runs.spec import JobSpec, names_in, parse
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import resolve
from scene_attack_service.settings import Settings
from tests.unit.scenes.scene_files import Room

pytestmark = pytest.mark.integration

CAMERA = {"size": [48, 64], "azimuth": 0.4, "roll": 0.2}
LIGHTS = {
    "ambient": 0.2,
    "points": [{"energy": 12.3, "position": [1.1, 1.7, 1.3]}],
    "directional": [{"energy": 0.7, "direction": [0.3, -1, -1]}],
    "spots": [{"energy": 9.1, "position": [-1, 1.5, 1], "direction": [1, -1.5, -1], "outer_angle": 0.6}],
}
SHADOWS = {"resolution": 128, "samples": 4}
MOVES = ["illumination", "color", "translation", "rotation", "camera"]
ROOM = "a room of somebody else"
JOBS: dict[str, dict[str, Any]] = {
    "everything that pyrender changes": {
        "scene": {
            "camera": CAMERA,
            "objects": [
                {"mesh": "furniture/soccer-ball", "scale": 0.7},
                {"mesh": "primitive/cube", "scale": 0.4, "translation": [0.4, 0.1, 0.3], "metallic": 0.3},
            ],
            "fixed": [{"mesh": "primitive/torus", "translation": [-0.4, 0, -0.5], "color": [0.3, 0.6, 0.2]}],
            "floor": {"contact": True, "size": 6},
            "shadows": SHADOWS,
            "lights": LIGHTS,
            "background": {},
        },
        "attack": {"renderer": "pyrender", "method": "zoo", "groups": MOVES, "steps": 3, "truncation": None},
    },
    ROOM: {
        "scene": {
            "source": {"format": "file", "change": ["Ball", "Lamp"]},
            "camera": {"size": [48, 64]},
            "shadows": SHADOWS,
        },
        "attack": {"renderer": "pyrender", "method": "zoo", "groups": MOVES, "steps": 3, "truncation": None},
    },
    "light and surface of the torch renderer": {
        "scene": {"camera": CAMERA, "objects": [{"mesh": "primitive/torus", "material": "plastic"}]},
        "attack": {"renderer": "torch", "method": "fgsm", "groups": ["illumination", "material"], "steps": 3},
    },
    "poses of the torch renderer": {
        "scene": {"camera": CAMERA, "objects": [{"mesh": "primitive/cube", "material": "plastic"}]},
        "attack": {"renderer": "torch", "method": "fgsm", "groups": ["rotation", "camera"], "steps": 3},
    },
}


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Library:
    return Library(Settings().cache_dir, tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def jobs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the jobs that were run, each in a folder of its name."""
    return tmp_path_factory.mktemp("jobs")


def finished(library: Library, job: dict[str, Any], folder: Path) -> Finished:
    """A finished job; it is run once, and its files are in the folder."""
    if not folder.exists():
        if "source" in job["scene"]:
            file = library.add_mesh(Room().glb, "glb").name
            job = {**job, "scene": {**job["scene"], "source": {**job["scene"]["source"], "file": file}}}
        folder.mkdir()
        execute(parse(job, names_in(library)), folder, library)
    return read_finished({path.name: path.read_bytes for path in folder.iterdir() if path.is_file()}, library)


def imported(library: Library, glb: bytes, like: JobSpec) -> JobSpec:
    """The job of a request that has a file as its source, and the attack of another job."""
    source = {"format": "file", "file": library.add_mesh(glb, "glb").name}
    attack = like.attack.model_dump(mode="json")
    return parse({"scene": {"source": source}, "target": like.target.model_dump(), "attack": attack}, names_in(library))


def image(spec: JobSpec, library: Library) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """The exact image of a job's scene as it is saved, uint8 [H, W, 3]."""
    attack = spec.attack
    made = build(resolve(spec.scene, library), attack.renderer, attack.base_renderer, attack.groups, "exact", 0.1)
    pixels: np.ndarray[Any, np.dtype[np.uint8]] = to_bytes(made.render({}))[0].numpy()
    return pixels


def saved(folder: Path, name: str) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return np.asarray(Image.open(folder / name).convert("RGB"))


@pytest.mark.parametrize("name", JOBS)
def test_the_export_is_the_job_to_the_pixel(name: str, library: Library, jobs: Path) -> None:
    done = finished(library, JOBS[name], jobs / name)
    before = imported(library, done.glb("before"), done.spec)
    assert before.scene.model_copy(update={"source": None}) == done.spec.scene.model_copy(update={"source": None})
    assert np.array_equal(image(before, library), saved(jobs / name, "original.png"))


@pytest.mark.parametrize("name", [name for name in JOBS if "light and surface" not in name])
def test_the_scene_after_the_attack_is_the_attacked_image_to_the_pixel(name: str, library: Library, jobs: Path) -> None:
    done = finished(library, JOBS[name], jobs / name)
    moved = max(float(change.abs().max()) for change in done.perturbation.values())
    assert moved > 0
    attacked = saved(jobs / name, "attacked.png")
    assert not np.array_equal(attacked, saved(jobs / name, "original.png"))
    after = imported(library, done.glb("after"), done.spec)
    assert np.array_equal(
        resolve(after.scene, library).projection, done.scene.projection
    )  # which decides hidden pixels
    assert np.array_equal(image(after, library), attacked)


def test_a_bent_object_is_read_from_the_file(library: Library, jobs: Path) -> None:
    job = JOBS["poses of the torch renderer"]
    shape = {**job, "attack": {**job["attack"], "groups": ["shape"]}}
    done = finished(library, shape, jobs / "shape")
    spec = imported(library, done.glb("after"), done.spec)
    [thing] = spec.scene.objects
    assert thing.mesh.startswith("sha256:")
    assert thing.material == "plastic"
    off = np.abs(image(spec, library).astype(int) - saved(jobs / "shape", "attacked.png").astype(int)).max(axis=2)
    assert (off > 1).mean() < 0.01  # its vertices are fitted anew, so that samples at its outline may flip


def test_a_mesh_that_is_not_here_is_read_from_the_file(library: Library, jobs: Path, tmp_path: Path) -> None:
    """On a machine without the room, each object is the file's: equal but for rounding."""
    done = finished(library, JOBS[ROOM], jobs / ROOM)
    other = Library(tmp_path / "cache", tmp_path / "data")
    spec = imported(other, done.glb("before"), done.spec)
    off = np.abs(image(spec, other).astype(int) - saved(jobs / ROOM, "original.png").astype(int)).max(axis=2)
    assert (off > 1).mean() < 0.01


def test_a_file_that_another_program_wrote_anew_is_read_as_any_other(library: Library, jobs: Path) -> None:
    done = finished(library, JOBS[ROOM], jobs / ROOM)
    glb = done.glb("before")
    length = int.from_bytes(glb[12:16], "little")
    tree = json.loads(glb[20 : 20 + length])
    tree["asset"]["generator"] = "Another program"
    text = json.dumps(tree, separators=(",", ":")).encode().ljust(length)
    assert len(text) == length
    spec = imported(library, glb[:20] + text + glb[20 + length :], done.spec)
    assert len(spec.scene.objects) == 3
