"""Jobs taken along: what another program makes of an export is the attacked image."""

import json
import re
import subprocess
import sys
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest
import trimesh
from PIL import Image
from safetensors import safe_open

from scene_attack.export.bundle import into_folder, write_bundle
from scene_attack.runs.execute import execute
from scene_attack.runs.spec import parse
from scene_attack.scenes import environment
from scene_attack.scenes.library import Library
from scene_attack_accuracy.stability.gltf_file import file_of
from scene_attack_accuracy.stability.objects import square_arrays
from scene_attack_service.settings import Settings
from tests.integration.conftest import PATIENCE, Stack
from tests.integration.specs import ENDLESS
from tests.unit.client.command_line import Done, cli

pytestmark = pytest.mark.integration

RNG = np.random.default_rng(5)
LAMPS = {
    "ambient": 0.3,
    "points": [{"energy": 18}, {"energy": 9, "position": [-2, 1, 1]}],
    "directional": [{"energy": 1, "direction": [1, -1, -0.5]}],
    "spots": [{"position": [0, 2, 2], "direction": [0, -2, -2.2], "inner_angle": 0.1, "outer_angle": 0.3}],
}
SHARE, LEVELS = 0.995, 1
"""The share of pixels whose values are within so many 255ths."""


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Library:
    return Library(Settings().cache_dir, tmp_path_factory.mktemp("data"))


def textured_glb() -> bytes:
    """A cut-out, see-through square with all maps of a glTF material and vertex colours."""

    def texels(*, alpha: bool = False) -> np.ndarray:
        small = RNG.integers(0, 256, (8, 8, 4 if alpha else 3), dtype=np.uint8)
        return small.repeat(8, axis=0).repeat(8, axis=1)

    bumps = np.full((16, 16, 3), (128, 128, 255), np.uint8)
    bumps[4:12, 4:12] = (150, 110, 245)
    material = {
        "pbrMetallicRoughness": {
            "baseColorTexture": texels(alpha=True),
            "baseColorFactor": [0.9, 0.03, 0.5, 0.8],
            "metallicRoughnessTexture": texels(),
            "roughnessFactor": 0.7,
        },
        "normalTexture": {"image": bumps, "scale": 0.7},
        "occlusionTexture": {"image": texels(), "strength": 0.5},
        "emissiveTexture": texels(),
        "emissiveFactor": [0.1, 0.2, 0.3],
        "alphaMode": "BLEND",
        "doubleSided": True,
    }
    colors = np.array([(1, 1, 1, 1), (0.2, 0.9, 1, 1), (1, 0.3, 0.3, 0.7), (1, 1, 0.4, 1)])
    return file_of(square_arrays(COLOR_0=colors), material)


def colored_ply() -> bytes:
    ball = trimesh.creation.icosphere(subdivisions=3)
    ball.visual.vertex_colors = RNG.integers(0, 256, (len(ball.vertices), 4), dtype=np.uint8) | [0, 0, 0, 255]
    return bytes(ball.export(file_type="ply"))


def scenes(library: Library) -> dict[str, dict[str, Any]]:
    square, ball = library.add_mesh(textured_glb(), "glb").name, library.add_mesh(colored_ply(), "ply").name
    return {
        "textured glb": {"objects": [{"mesh": square, "rotation": [0.2, 0.5, 0]}], "lights": LAMPS},
        "vertex colours": {"objects": [{"mesh": ball}], "ground": [0.1, 0.6, 0.9]},
        "map behind": {"objects": [{"mesh": "furniture/sofa"}], "background": {}},
        "several": {
            "camera": {"size": [96, 160], "elevation": 0.5},
            "objects": [
                {"mesh": "furniture/drill", "scale": 0.5, "translation": [0.3, 0, 0]},
                {"mesh": "furniture/drill", "scale": 0.5, "translation": [-0.5, 0.1, -0.2], "color": [0.3, 0.9, 0.5]},
                {"mesh": "primitive/sphere", "scale": 0.3, "translation": [-0.1, -0.2, 0.4], "metallic": 0.9},
                {"mesh": square, "scale": 0.5, "translation": [0, 0.2, 0.5]},
            ],
            "floor": {"height": -0.4, "color": [0.3, 0.2, 0.1]},
            "lights": LAMPS,
        },
    }


@pytest.mark.parametrize("name", ["textured glb", "vertex colours", "map behind", "several"])
def test_stock_pyrender_draws_the_attacked_image_from_the_exported_scene(
    library: Library, tmp_path: Path, name: str
) -> None:
    """The search draws all coordinates at random, so that after it every light, colour and pose has moved."""
    scene = scenes(library)[name]
    scene = {"camera": {"size": [128, 128]}} | scene
    attack = {"renderer": "pyrender", "method": "cma-es", "steps": 6, "groups": ["illumination", "color"]}
    attack["groups"] += ["translation", "rotation", "camera"]
    spec = parse({"scene": scene, "attack": attack, "seed": 3})
    done, out = tmp_path / "done", tmp_path / "export"
    execute(spec, done, library)
    write_bundle({file.name: file.read_bytes for file in done.iterdir()}, library, into_folder(out))
    moved = {row["group"] for row in json.loads((out / "parameters.json").read_text())["parameters"] if row["change"]}
    assert moved == set(attack["groups"])
    for which, image in (("before", "original"), ("after", "attacked")):
        command = [sys.executable, "render_exported.py", f"scene_{which}.glb", "rendered.png"]
        drawn = subprocess.run(
            [*command, "--compare", f"{image}.png"],
            cwd=out,
            capture_output=True,
            text=True,
            check=False,
            timeout=PATIENCE,
        )
        assert drawn.returncode == 0, drawn.stderr
        rendered = np.asarray(Image.open(out / "rendered.png")).astype(int)
        difference = np.abs(rendered - np.asarray(Image.open(out / f"{image}.png"))).max(axis=-1)
        assert float((difference <= LEVELS).mean()) >= SHARE
    before, after = (np.asarray(Image.open(out / f"{image}.png")) for image in ("original", "attacked"))
    assert ((before != after).any(axis=-1)).mean() > 0.05  # the attack shows, so that both files were drawn


def test_light_and_normals_of_a_torch_job(library: Library, tmp_path: Path) -> None:
    """The image of a matte white ball follows from the exported map and normals by the sum over the map's texels."""
    spec = parse(
        {
            "scene": {
                "camera": {"size": [48, 48], "field_of_view": 0.4},
                "objects": [{"mesh": "primitive/sphere", "material": "matte"}],
                "lights": {"environment": {"size": [8, 18], "rotation": 0.4}},
            },
            "attack": {
                "renderer": "torch",
                "groups": ["normals", "illumination", "illumination_rgb", "lamp"],
                "steps": 4,
                "learning_rate": {"normals": 0.05, "illumination": 0.5, "illumination_rgb": 0.5, "lamp": 0.1},
            },
        }
    )
    done, out = tmp_path / "done", tmp_path / "export"
    execute(spec, done, library)
    write_bundle({file.name: file.read_bytes for file in done.iterdir()}, library, into_folder(out))
    assert {file.name for file in out.iterdir()} >= {"normals_after.png", "scene_before.glb", "README.md"}
    scene = json_of((out / "scene_after.glb").read_bytes())["scenes"][0]["extras"]
    assert scene["environment"] == "environment_after.exr"
    images = []
    for which in ("before", "after"):
        radiance = environment.average(environment.read_file(out / f"environment_{which}.exr", None).radiance, 8, 18)
        normals = np.load(out / f"normals_{which}.npy")
        images.append(matte(radiance, normals, spec.scene.camera.azimuth, spec.scene.camera.elevation))
    covered = (np.load(out / "normals_before.npy") != 0).any(axis=-1)
    middle = (
        covered & np.roll(covered, 3, 0) & np.roll(covered, -3, 0) & np.roll(covered, 3, 1) & np.roll(covered, -3, 1)
    )
    for image, name in zip(images, ("original", "attacked"), strict=True):
        shown = np.asarray(Image.open(out / f"{name}.png")) / 255
        linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
        ratio = linear[middle] / image[middle].clip(1e-6)
        # The matte preset is Lambertian to a few percent; its white has the mesh's albedo.
        assert np.std(ratio / np.median(ratio)) < 0.06
    assert np.abs(images[1] - images[0])[middle].max() > 0.02


def matte(radiance: np.ndarray, normals: np.ndarray, azimuth: float, elevation: float) -> np.ndarray:
    """White Lambertian surfaces [H, W, 3] of normals in the camera's frame under a map in the world's."""
    rows, cols = radiance.shape[:2]
    theta = (np.arange(rows) + 0.5) * np.pi / rows
    phi = (np.arange(cols) + 0.5) * 2 * np.pi / cols
    theta, phi = np.meshgrid(theta, phi, indexing="ij")
    world = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], -1)
    back = np.array([np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)])
    right = np.array([np.cos(azimuth), 0, -np.sin(azimuth)])
    frame = np.stack([right, np.cross(back, right), back])
    edges = np.cos(np.linspace(0, np.pi, rows + 1))
    solid = (edges[:-1] - edges[1:])[:, None, None] * 2 * np.pi / cols
    cosines = np.einsum("hwc,ijc->hwij", normals, world @ frame.T).clip(0)
    found: np.ndarray = np.einsum("hwij,ijk->hwk", cosines, radiance * solid) / np.pi
    return found


def json_of(glb: bytes) -> dict[str, Any]:
    length = int.from_bytes(glb[12:16], "little")
    found: dict[str, Any] = json.loads(glb[20 : 20 + length])
    return found


def test_the_service_exports_a_finished_job(stack: Stack, tmp_path: Path) -> None:
    spec = {
        "scene": {"camera": {"size": [64, 64]}, "objects": [{"mesh": "primitive/sphere"}]},
        "attack": {"renderer": "pyrender", "steps": 1, "queries": 20},
    }
    job = stack.ended(stack.submit(spec))
    url = f"/v1/jobs/{job['id']}"
    answer = stack.client.get(f"{url}/export")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "application/zip")
    folder = f"scene-attack-{job['id'][:8]}"
    assert answer.headers["content-disposition"] == f'attachment; filename="{folder}.zip"'
    with ZipFile(BytesIO(answer.content)) as archive:
        names = {name.removeprefix(f"{folder}/") for name in archive.namelist()}
        attacked = archive.read(f"{folder}/attacked.png")
        after = archive.read(f"{folder}/scene_after.glb")
        assert job["id"] in archive.read(f"{folder}/README.md").decode()
        archive.extract(f"{folder}/perturbation.safetensors", tmp_path)
    assert names >= {"scene_before.glb", "result.json", "request.json", "parameters.json", "render_exported.py"}
    assert attacked == stack.client.get(f"{url}/artifacts/attacked.png").content
    with safe_open(tmp_path / folder / "perturbation.safetensors", "numpy") as tensors:
        said = json.loads(tensors.metadata()["groups"])
    assert said["illumination"]["names"][1] == "point 0 energy"
    assert said["translation"]["axes"] == ["objects", "3"]
    glb = stack.client.get(f"{url}/scene.glb", params={"which": "after"})
    assert (glb.headers["content-type"], glb.content) == ("model/gltf-binary", after)
    again = stack.client.get(f"{url}/scene.glb", headers={"If-None-Match": glb.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert stack.client.get(f"{url}/export").content == answer.content

    def export(to: Path) -> Done:
        return cli("export", job["id"], "--url", str(stack.client.base_url), "--out", str(to))

    assert export(tmp_path / "taken").returncode == 0
    taken = tmp_path / "taken"
    assert {file.relative_to(taken).as_posix() for file in taken.rglob("*") if file.is_file()} == names
    assert export(tmp_path / "taken.zip").returncode == 0
    assert (tmp_path / "taken.zip").read_bytes() == answer.content
    refused = export(tmp_path / "taken")
    assert refused.returncode == 2
    assert re.search("there already, and no empty folder", refused.stderr)


def test_a_job_without_a_result_is_not_exported(stack: Stack) -> None:
    job_id = stack.submit(ENDLESS)
    for path in ("export", "scene.glb"):
        answer = stack.client.get(f"/v1/jobs/{job_id}/{path}")
        assert answer.status_code == 409
        assert answer.json()["detail"] == "the job has no result to export: it has not ended"
    stack.client.post(f"/v1/jobs/{job_id}/cancel")
    stack.ended(job_id)
    assert "ended as cancelled" in stack.client.get(f"/v1/jobs/{job_id}/export").json()["detail"]
    assert stack.client.get(f"/v1/jobs/{'0' * 32}/export").status_code == 404
