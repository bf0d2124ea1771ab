"""Resolving a scene: full paths in errors, what is in view, and a digest that moves with everything that matters."""

import json
import subprocess
import sys

import numpy as np
import pytest

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.bundle import About, Bundle
from scene_attack.scenes.description import Scene
from scene_attack.scenes.environment import average
from scene_attack.scenes.resolve import canonical_json, resolve
from tests.unit.scenes.test_library import TETRAHEDRON

pytestmark = pytest.mark.slow


def scene(*objects, **more):
    return Scene.model_validate({"objects": list(objects) or [{"mesh": "primitive/cube"}], **more})


def test_resolves_objects_camera_and_light(library):
    found = resolve(
        scene(
            {"mesh": "furniture/grand-piano"},
            {"mesh": "primitive/sphere", "translation": (0.2, 0, 0), "scale": 0.5},
            lights={"environment": {"map": "city", "size": (5, 7), "rotation": 0.4}},
            camera={"azimuth": 0, "elevation": 0, "distance": 3, "size": (100, 200)},
        ),
        library,
    )
    assert [mesh.triangles for mesh in found.meshes] == [4244, 20480]
    assert np.allclose(found.models[1], [[0.5, 0, 0, 0.2], [0, 0.5, 0, 0], [0, 0, 0.5, 0], [0, 0, 0, 1]])
    assert np.allclose(found.eye, [0, 0, 3])
    assert found.environment.shape == (5, 7, 3)
    assert np.array_equal(found.environment, average(library.environment("city").radiance, 5, 7, 0.4))
    mesh, light = found.credits(lit_by_map=True)
    assert "Dante" in mesh
    assert "city" in light
    assert found.credits(lit_by_map=False) == [mesh], "pyrender shows nothing of the map"


def test_everything_fits_between_the_planes(library):
    found = resolve(
        scene(
            {"mesh": "primitive/cube"},
            {"mesh": "primitive/cube", "translation": (0, 0, -90), "scale": 10},
            camera={"azimuth": 0, "elevation": 0},
        ),
        library,
    )
    behind = found.projection @ np.linalg.inv(found.view) @ [0, 0, -90 - 10, 1]
    assert behind[2] < behind[3]


@pytest.mark.parametrize(
    ("bad", "field", "word"),
    [
        ({"mesh": "furniture/grand-pian"}, "scene.objects.1.mesh", "furniture/grand-piano"),
        ({"mesh": "primitive/cube", "translation": (50, 0, 0)}, "scene.objects.1", "out of view"),
        ({"mesh": "primitive/cube", "translation": (0, 0, 50)}, "scene.objects.1", "nothing of it"),
        ({"mesh": "primitive/cube", "scale": 0.001}, "scene.objects.1", "too small"),
    ],
)
def test_errors_name_the_object(library, bad, field, word):
    with pytest.raises(InvalidRequest) as error:
        resolve(scene({"mesh": "primitive/sphere"}, bad, camera={"azimuth": 0, "elevation": 0}), library)
    assert error.value.field == field
    assert word in error.value.detail


def test_a_plane_seen_edge_on_is_not_in_view(library):
    edge_on = {"mesh": "primitive/plane", "rotation": (0, np.pi / 2, 0)}
    with pytest.raises(InvalidRequest, match="out of view"):
        resolve(scene(edge_on, camera={"azimuth": 0, "elevation": 0, "distance": 100}), library)


def test_errors_name_the_map(library):
    with pytest.raises(InvalidRequest) as error:
        resolve(scene(lights={"environment": {"map": "stduio"}}), library)
    assert error.value.field == "scene.lights.environment.map"
    assert "'studio'" in error.value.detail


def test_the_digest_moves_with_every_part_of_the_scene(library):
    scenes = [
        scene(),
        scene({"mesh": "primitive/sphere"}),
        scene({"mesh": "primitive/cube", "color": (1, 1, 0.5)}),
        scene({"mesh": "primitive/cube", "translation": (0.01, 0, 0)}),
        scene({"mesh": "primitive/cube"}, {"mesh": "primitive/cube"}),
        scene(camera={"azimuth": 0.62}),
        scene(lights={"environment": {"map": "city"}}),
        scene(lights={"environment": {"rotation": 0.1}}),
        scene(lights={"points": []}),
        scene(ground=(0, 0, 0)),
        *(scene({"mesh": "primitive/cube", "metallic": metallic}) for metallic in (0.0, 1.0)),
        scene({"mesh": "primitive/cube", "roughness": 0.5}),
        *(scene(floor={"height": -0.7} | more) for more in ({}, {"size": 5}, {"roughness": 0.5})),
    ]
    digests = [resolve(s, library).sha256 for s in scenes]
    assert len(set(digests)) == len(digests)
    assert all(len(digest) == 64 for digest in digests)


def test_ways_to_write_the_same_scene_have_the_same_digest(library):
    explicit = json.loads(canonical_json(scene()))
    explicit["camera"] = dict(reversed(explicit["camera"].items()))
    written = scene(
        {"mesh": "primitive/cube", "translation": [-0.0, 0, 0], "scale": 1, "color": [1, 1, 1]}, ground=[0.5, 0.5, 0.5]
    )
    digests = {resolve(s, library).sha256 for s in (scene(), Scene.model_validate(explicit), written)}
    assert len(digests) == 1


def test_the_canonical_text_is_the_same_in_another_process():
    program = (
        "from scene_attack.scenes.description import Scene;from scene_attack.scenes.resolve import canonical_json;"
        "print(canonical_json(Scene(objects=[{'mesh':'primitive/cube','translation':(0.1,-0.0,1e-9)}])))"
    )
    other = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.strip()
    assert other == canonical_json(scene({"mesh": "primitive/cube", "translation": (0.1, 0.0, 1e-9)}))
    assert " " not in other
    assert '"translation":[0.1,0.0,1e-09]' in other


def test_the_digest_moves_with_the_contents_of_a_map(library, assets, tmp_path):
    from scene_attack.scenes.library import Library

    (tmp_path / "environments").mkdir()
    (tmp_path / "environments" / "studio.exr").write_bytes((assets / "environments" / "city.exr").read_bytes())
    other = Library(tmp_path, tmp_path / "data", packaged=False)
    assert resolve(scene(), other).sha256 != resolve(scene(), library).sha256


def test_uploads_have_the_titles_that_people_gave_them(library):
    vase = library.add(Bundle("off", TETRAHEDRON, {}, About(title="vase"))).name
    found = resolve(scene({"mesh": vase}, {"mesh": "primitive/cube", "translation": [0.5, 0, 0]}), library)
    assert found.titles == {vase: "vase"}
