"""A floor that the objects stand on: its height against closed forms, and the same scene with that height given."""

from math import pi, sqrt
from typing import Any

import pytest

from scene_attack.runs.spec import digest, parse
from scene_attack.scenes.resolve import ResolvedScene, canonical_json, resolve
from tests.unit.jobs.small import LIBRARY

TURNED = {"mesh": "primitive/cube", "scale": 0.6, "rotation": [0, 0, pi / 4], "translation": [0, 0.1, 0]}
BALL = {"mesh": "primitive/sphere", "scale": 0.5, "translation": [0.4, 0.3, 0]}


def resolved(floor: dict[str, Any] | None, *objects: dict[str, Any]) -> ResolvedScene:
    return resolve(parse({"scene": {"objects": list(objects or (TURNED,)), "floor": floor}}).scene, LIBRARY)


def height(found: ResolvedScene) -> float:
    assert found.description.floor is not None
    return found.description.floor.height


def half_side() -> float:
    [part] = LIBRARY.mesh("primitive/cube").parts
    return float(part.vertices[:, 1].max())


def test_a_cube_on_its_edge_stands_half_a_diagonal_above_the_floor() -> None:
    expected = 0.1 - 0.6 * sqrt(2) * half_side()
    assert height(resolved({"contact": True})) == pytest.approx(expected, abs=1e-6)
    assert height(resolved({"contact": True, "height": -0.2})) == pytest.approx(expected - 0.2, abs=1e-6)


def test_the_lowest_of_several_objects_touches_it() -> None:
    assert height(resolved({"contact": True}, BALL, TURNED)) == height(resolved({"contact": True}))
    lower = BALL | {"translation": [0.4, -0.6, 0]}
    assert height(resolved({"contact": True}, lower, TURNED)) < height(resolved({"contact": True}))


def test_every_other_object_is_lowered_until_it_touches_it_too() -> None:
    [ball] = LIBRARY.mesh("primitive/sphere").parts
    radius = float(-ball.vertices[:, 1].min())
    found = resolved({"contact": True}, BALL, TURNED)
    lowered, stays = found.description.objects
    assert stays.translation == (0, 0.1, 0)
    assert lowered.translation == pytest.approx((0.4, height(found) + 0.5 * radius, 0), abs=1e-6)
    assert [model[:3, 3].tolist() for model in found.models] == [[*lowered.translation], [*stays.translation]]


def test_it_is_the_floor_of_that_height_in_every_way_but_its_request() -> None:
    found = resolved({"contact": True})
    same = resolved({"height": height(found)})
    assert found.description == same.description
    assert (found.placed[-1].mesh.parts[0].vertices == same.placed[-1].mesh.parts[0].vertices).all()
    assert (found.projection == same.projection).all()
    assert found.sha256 != same.sha256


def test_a_floor_without_it_keeps_its_digest() -> None:
    spec = parse({"scene": {"objects": [TURNED], "floor": {"height": -0.3}}})
    assert "contact" not in canonical_json(spec.scene)
    assert digest(spec) == digest(parse({"scene": {"objects": [TURNED], "floor": {"height": -0.3, "contact": False}}}))
