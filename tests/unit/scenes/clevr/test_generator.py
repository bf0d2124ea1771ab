"""Generated scenes: the same for the same seed, within the limits that CLEVR sets, and varied."""

from collections import Counter
from itertools import combinations
from math import hypot

import pytest

from services.errors import InvalidRequest
from services.scenes.clevr.generator import generate
from services.scenes.clevr.records import ATTRIBUTES, RADIUS, Rig, half_height

SCENES = [generate(7, k, split="test") for k in range(120)]


def test_a_scene_depends_on_seed_split_and_index_alone() -> None:
    assert generate(7, 60, split="test") == SCENES[60]
    others = [generate(8, 60, split="test"), generate(7, 60, split="train"), SCENES[61]]
    assert all(other.objects != SCENES[60].objects for other in others)


def test_number_of_objects_is_uniform_within_its_bounds() -> None:
    counts = Counter(len(scene.objects) for scene in SCENES)
    assert set(counts) == set(range(3, 11))
    assert max(counts.values()) < 30  # 15 each are expected, with a standard deviation of 3.6
    assert {len(generate(0, k, objects=(4, 5)).objects) for k in range(20)} == {4, 5}


def test_objects_keep_their_distances_and_stand_on_the_plane() -> None:
    for scene in SCENES:
        for one in scene.objects:
            x, y, z = one.coords_3d
            assert abs(x) <= 3
            assert abs(y) <= 3
            assert z == half_height(one.shape, one.size)
        for one, other in combinations(scene.objects, 2):
            offset = [a - b for a, b in zip(one.coords_3d, other.coords_3d, strict=True)]
            assert hypot(offset[0], offset[1]) >= RADIUS[one.size] + RADIUS[other.size] + 0.25
            for name in ("right", "behind"):
                along = scene.directions[name]
                assert abs(offset[0] * along[0] + offset[1] * along[1]) >= 0.4


def test_every_pair_of_objects_is_related_in_both_directions() -> None:
    for scene in SCENES:
        everything = set(range(len(scene.objects)))
        for first, second in (("left", "right"), ("front", "behind")):
            for k in everything:
                here, there = set(scene.relationships[first][k]), set(scene.relationships[second][k])
                assert here | there == everything - {k}
                assert not here & there


def test_attributes_take_every_value_about_as_often() -> None:
    objects = [one for scene in SCENES for one in scene.objects]
    for attribute, values in ATTRIBUTES.items():
        counts = Counter(one.value(attribute) for one in objects)
        assert set(counts) == set(values)
        if attribute != "size":  # large objects fit less often
            assert max(counts.values()) < 1.6 * min(counts.values())


def test_camera_and_lights_are_jittered_within_their_bounds() -> None:
    base = Rig()
    rigs = [scene.rig for scene in SCENES]
    for name, most in (("camera", 0.5), ("key", 1.0), ("fill", 1.0), ("back", 1.0)):
        for axis in range(3):
            moves = [getattr(rig, name)[axis] - getattr(base, name)[axis] for rig in rigs]
            assert 0.9 * most < max(moves) <= most
            assert -most <= min(moves) < -0.9 * most


def test_more_objects_than_fit_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.scenes.clevr.generator.RESTARTS", 3)
    with pytest.raises(InvalidRequest, match="40 objects do not fit"):
        generate(0, 0, objects=(40, 40))


def test_hidden_objects_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.scenes.clevr.generator.MIN_PIXELS", 100_000)
    monkeypatch.setattr("services.scenes.clevr.generator.DISCARDS", 3)
    with pytest.raises(InvalidRequest, match="cannot all be seen"):
        generate(0, 0)
