from collections.abc import Iterator

import numpy as np
import pytest

from scene_attack.rendering.color import to_bytes
from scene_attack.rendering.factory import build
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import resolve
from scene_attack_questions.clevr.description import describe
from scene_attack_questions.clevr.generator import generate, object_numbers
from scene_attack_questions.clevr.records import RGB
from training.iep.data import coarse, draw, varied

RECORD = generate(2, 0, objects=(3, 3))
SCENE = describe(RECORD)


def test_the_image_is_that_of_the_exact_renderer(library: Library) -> None:
    exact = build(resolve(SCENE, library), "pyrender", tolerance="exact").exact()
    assert np.array_equal(draw(SCENE, "pyrender", library), to_bytes(exact.render({}))[0].numpy())


@pytest.mark.parametrize("renderer", ["pyrender", "torch"])
def test_coarse_and_varied_scenes_show_their_objects_where_they_are(renderer: str, library: Library) -> None:
    """Channels that clearly differ in CLEVR's RGB differ likewise in the mean of an object's pixels."""
    shown = draw(coarse(varied(SCENE, np.random.default_rng(1))), renderer, library).astype(np.float64)
    rig = RECORD.rig
    assert rig is not None
    numbers = object_numbers(RECORD.objects, rig)
    for k, one in enumerate(RECORD.objects):
        mean, wanted = shown[numbers == k].mean(0), np.array(RGB[one.color], np.float64)
        for a, b in ((0, 1), (1, 2), (2, 0)):
            if abs(wanted[a] - wanted[b]) > 40:
                assert (mean[a] - mean[b]) * np.sign(wanted[a] - wanted[b]) > 10
        if one.color == "gray":
            assert np.ptp(mean) < 30
    floor = shown[numbers < 0]
    assert np.ptp(floor.mean(0)) < 30


def test_variation_stays_within_bounds_and_keeps_the_answers() -> None:
    for random in _randoms(20):
        found = varied(SCENE, random)
        assert found != SCENE
        assert found.camera == SCENE.camera
        for one, other in zip(found.objects, SCENE.objects, strict=True):
            assert (one.mesh, one.translation, one.scale) == (other.mesh, other.translation, other.scale)
            assert max(abs(a - b) for a, b in zip(one.color, other.color, strict=True)) < 0.2
            assert abs((one.metallic or 0) - (other.metallic or 0)) < 0.3
        type(found).model_validate_json(found.model_dump_json())
    assert varied(SCENE, np.random.default_rng(7)) == varied(SCENE, np.random.default_rng(7))


def _randoms(count: int) -> Iterator[np.random.Generator]:
    return (np.random.default_rng(seed) for seed in range(count))
