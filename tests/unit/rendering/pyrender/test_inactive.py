"""Coordinates that change nothing, in scenes made so that it is known which."""

import torch

from scene_attack.rendering.pyrender.planner import LARGEST_STEP
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import Lights, PointLight, SceneObject
from tests.unit.rendering.shapes import mesh, placed, quad, scene, sphere

BEHIND = PointLight(energy=30.0, position=(0.3, 0.2, -1.0))
BEFORE = PointLight(energy=30.0, position=(0.3, 0.2, 1.5))


def plane(*lights: PointLight, ambient: float = 0.3, color: tuple[float, ...] = (1, 1, 1, 1)) -> PyrenderRenderer:
    """A square that faces the camera."""
    description = scene((24, 32), lights=Lights(ambient=ambient, points=lights))
    return PyrenderRenderer(placed(description, mesh(quad(0.4, color=color))))


def names(renderer: PyrenderRenderer, reach: float = LARGEST_STEP) -> list[str]:
    groups = dict.fromkeys(renderer.groups, reach)
    found = renderer.inactive(renderer.initial(), groups)
    for one in found:  # what is said to change nothing changes nothing
        for sign in (1, -1):
            moved = renderer.initial()
            moved[one.group].view(-1)[one.index] += sign * reach
            images = renderer.radiance({group: value[None] for group, value in moved.items()})
            assert torch.equal(images, renderer.radiance({})), one
    return [one.name for one in found]


def test_in_an_ordinary_scene_every_coordinate_counts() -> None:
    renderer = PyrenderRenderer(placed(scene((32, 32)), mesh(sphere(0.5, 24))))
    assert names(renderer) == []
    [coordinates] = [item for item in renderer.plan.items if item.what == "coordinates"]
    assert (coordinates.kept, coordinates.of) == (14, 14)


def test_a_light_without_energy_may_be_anywhere_but_its_energy_counts() -> None:
    dark = PointLight(energy=0.0, position=(0.3, 0.2, 1.5))
    assert names(plane(BEFORE, dark)) == ["point 1 x", "point 1 y", "point 1 z"]


def test_a_light_behind_everything_neither_moves_nor_grows() -> None:
    assert names(plane(BEFORE, BEHIND)) == ["point 1 energy", "point 1 x", "point 1 y", "point 1 z"]


def test_a_light_that_could_come_round_counts() -> None:
    close = PointLight(energy=30.0, position=(0.3, 0.2, -0.05))
    assert names(plane(close), reach=0.1) == ["point 0 energy"]
    assert names(plane(close), reach=0.01) == ["point 0 energy", "point 0 x", "point 0 y", "point 0 z"]


def test_colours_that_are_not_seen() -> None:
    assert names(plane(BEFORE, color=(0.5, 0, 0.5, 1))) == ["object 0 color green"]
    unlit = names(plane(BEHIND, ambient=0.0))
    assert unlit[-3:] == ["object 0 color red", "object 0 color green", "object 0 color blue"]


def test_an_object_behind_another_has_a_pose_that_counts_and_no_colour() -> None:
    description = scene((24, 32), objects=2)
    wall, hidden = mesh(quad(0.6)), mesh(quad(0.1, centre=(0, 0, -0.3)))
    found = names(PyrenderRenderer(placed(description, wall, hidden)))
    assert found == ["object 1 color red", "object 1 color green", "object 1 color blue"]


def test_an_object_out_of_the_frame_has_nothing_that_counts() -> None:
    description = scene((24, 32), objects=2)
    away = SceneObject(mesh="primitive/b", translation=(9.0, 0, 0))
    description = description.model_copy(update={"objects": (description.objects[0], away)})
    found = names(PyrenderRenderer(placed(description, mesh(quad(0.4)), mesh(quad(0.4)))))
    kinds = ["color red", "color green", "color blue"] + [
        f"{g} {a}" for g in ("translation", "rotation") for a in "xyz"
    ]
    assert sorted(found) == sorted(f"object 1 {kind}" for kind in kinds)


def test_an_object_just_out_of_the_frame_could_come_in() -> None:
    description = scene((24, 24), objects=2)
    away = SceneObject(mesh="primitive/b", translation=(1.3, 0, 0))
    description = description.model_copy(update={"objects": (description.objects[0], away)})
    renderer = PyrenderRenderer(placed(description, mesh(quad(0.4)), mesh(quad(0.4))))
    assert renderer.out_of_frame(renderer.initial(), 1, 0.01, turned=False)
    assert not renderer.out_of_frame(renderer.initial(), 1, 0.2, turned=False)
    assert not any("translation" in name for name in names(renderer, reach=0.2))


def test_skipped_coordinates_are_in_the_plan_with_their_proof() -> None:
    [coordinates] = [item for item in plane(BEFORE, BEHIND).plan.items if item.what == "coordinates"]
    assert (coordinates.kept, coordinates.of) == (14, 18)
    assert "point 1 energy: the light is behind all that is seen" in coordinates.why
    assert coordinates.error == 0
