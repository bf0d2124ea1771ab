from collections.abc import Mapping

import numpy as np
import pytest
import torch

from scene_attack.attacks.differences import estimate
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.limits import Limits
from scene_attack.attacks.problem import AttackProblem
from scene_attack.rendering.pyrender.batching import Array, alone, shared
from scene_attack.rendering.pyrender.planner import both_sides
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import Lights, PointLight, SceneObject
from tests.unit.rendering.shapes import PLATFORMS, mesh, on_platform, placed, scene, six_parts, sphere

pytestmark = pytest.mark.slow


def sides(objects: int = 1) -> dict[str, Array]:
    """Both sides of the differences of all coordinates, the camera's last."""
    renderer = PyrenderRenderer(placed(scene((8, 8), objects), *[mesh(sphere(0.3, 8))] * objects))
    return {g: v.numpy() for g, v in both_sides(renderer.initial(), renderer.groups).items()}


def pose_of(one: Mapping[str, Array]) -> bytes:
    """What decides where things are in an image."""
    return b"".join(one[group].tobytes() for group in ("camera", "translation", "rotation"))


def drawn(batch: dict[str, Array], most: int) -> list[dict[tuple[int, int], bytes]]:
    """What decides each channel of each row, in the batch and as the passes draw it."""
    asked = {}
    for row in range(len(batch["color"])):
        for channel in range(3):
            pose = pose_of({group: values[row] for group, values in batch.items()})
            asked[row, channel] = (
                pose + batch["illumination"][row].tobytes() + batch["color"][row, :, channel].tobytes()
            )
    given = {}
    for one in shared(batch, most):
        pose = pose_of(vars(one))
        for row, channel, slot in one.users:
            assert (row, channel) not in given
            light = one.illuminations[slot].tobytes()
            given[row, channel] = pose + light + one.colors[slot][:, channel].tobytes()
    return [asked, given]


@pytest.mark.parametrize("most", [1, 3, 8])
@pytest.mark.parametrize("objects", [1, 2])
def test_every_channel_of_every_image_is_drawn_with_its_own_parameters(objects: int, most: int) -> None:
    asked, given = drawn(sides(objects), most)
    assert asked == given


def test_the_fourteen_differences_take_fourteen_passes_and_twenty_five_images() -> None:
    """12 poses by themselves; 10 sides of light and 3 for the 6 sides of colour and the image they are around."""
    fourteen = {group: values[:28] for group, values in sides().items()}
    passes = list(shared(fourteen, 8))
    assert len(passes) == 14
    assert sorted(len(one.colors) for one in passes) == [1] * 12 + [5, 8]
    assert len(list(alone(fourteen))) == 28


def test_every_camera_has_a_pass_of_its_own() -> None:
    camera = {group: values[28:] for group, values in sides().items()}
    assert [len(one.colors) for one in shared(camera, 8)] == [1] * 8


def test_channels_are_not_shared_between_lights() -> None:
    batch = {g: v[:2].copy() for g, v in sides().items()}
    batch["color"][1, 0, 0] = 0.5
    [one] = shared(batch, 8)
    assert len(one.colors) == 2  # two lights: nothing to share, though green and blue are the same
    batch["illumination"][1] = batch["illumination"][0]
    [one] = shared(batch, 8)
    assert [slot for row, channel, slot in one.users if channel] == [0] * 4
    np.testing.assert_array_equal(one.colors[1, 0, 0], 0.5)


_BITS = """
import torch
from scene_attack.rendering.pyrender.planner import both_sides
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import Lights, PointLight
from tests.unit.rendering import shapes

lights = Lights(ambient=0.3, points=(PointLight(), PointLight(energy=9.0, position=(-1.0, 0.5, 1.0))))
glass = shapes.mesh(shapes.sphere(0.3, 24, color=(0.8, 0.5, 0.2, 0.6)))
scene = shapes.placed(shapes.scene((31, 43), 2, lights, azimuth=0.5, elevation=0.4), shapes.six_parts(), glass)
renderer = PyrenderRenderer(scene)
batch = both_sides(renderer.initial(), renderer.groups)
together, whole = renderer.render(batch), renderer.exact().render(batch)
alone = torch.cat([renderer.render({g: v[i : i + 1] for g, v in batch.items()}) for i in range(len(together))])
print(torch.equal(together, alone), torch.equal(together, whole), float(together.std()) > 0.01, len(together))
"""


@pytest.mark.parametrize("platform", PLATFORMS)
def test_images_that_share_have_the_bits_they_have_alone_and_whole(platform: str) -> None:
    """No tolerance: the same instructions on the same numbers. Two lights, two objects, one of them of glass."""
    assert on_platform(platform, _BITS).split() == ["True", "True", "True", "62"]


def colored(seed: int, objects: int, lamps: int) -> PyrenderRenderer:
    """Balls and a textured cube side by side, of colours below 1."""
    random = np.random.default_rng(seed)
    lights = Lights(
        ambient=0.4, points=tuple(PointLight(energy=15.0, position=(x, 1.0, 1.5)) for x in np.linspace(-1, 1, lamps))
    )
    things = tuple(
        SceneObject(
            mesh="primitive/sphere",
            color=tuple(random.uniform(0.2, 0.9, 3)),
            translation=(0.45 * (i - (objects - 1) / 2), 0.1 * (i % 2), 0.0),
        )
        for i in range(objects)
    )
    description = scene((40, 64), lights=lights, distance=2.6).model_copy(update={"objects": things})
    meshes = [mesh(sphere(0.2, 12)) if i % 3 else six_parts() for i in range(objects)]
    return PyrenderRenderer(placed(description, *meshes))


@pytest.mark.parametrize(("objects", "lamps"), [(1, 1), (2, 2), (3, 1), (4, 3), (5, 1)])
@pytest.mark.parametrize("groups", [("color",), ("illumination", "color"), ("illumination", "color", "rotation")])
def test_images_whose_channels_come_from_several_passes_are_whole(
    objects: int, lamps: int, groups: tuple[str, ...]
) -> None:
    """A family of colours that spans passes: red of one, green and blue of another. White objects would hide it."""
    renderer = colored(objects, objects, lamps)
    sides = both_sides(renderer.initial(), groups)
    # In another order the channels of an image are further apart.
    order = torch.randperm(len(sides["color"]), generator=torch.Generator().manual_seed(objects))
    batch = {group: value[order] for group, value in sides.items()}
    together = renderer.render(batch)
    assert float((together - renderer.exact().render(batch)).abs().max()) < 1e-5
    assert len({image.numpy().tobytes() for image in together}) > len(together) // 2  # the differences can be seen


@pytest.mark.parametrize("coordinates", [8, 128])
def test_gradients_of_zoo_are_differences_of_exact_images(coordinates: int) -> None:
    renderer = colored(3, 3, 1)
    random = torch.Generator().manual_seed(0)
    weights = torch.randn(2, 40 * 64 * 3, generator=random) / 50

    class Linear:
        name = "linear"
        labels = ("one", "other")

        def logits(self, images: torch.Tensor) -> torch.Tensor:
            return images.flatten(1).float() @ weights.T

    def gradients(of: PyrenderRenderer, chosen: torch.Tensor) -> torch.Tensor:
        case = AttackProblem.of(of, Linear(), ResolvedGoal((0,), None), Limits.of(of, of.groups))  # type: ignore[arg-type]
        total = case.layout.total
        deltas = torch.full((len(chosen),), 0.01, dtype=torch.float64)
        return estimate(case, torch.zeros(total), chosen, deltas, 0.0).gradients

    total = sum(value.numel() for value in renderer.initial().values())
    for seed in range(3 if coordinates < total else 1):
        drawn = torch.randperm(total, generator=random.manual_seed(seed))[:coordinates].sort().values
        ours, exact = gradients(renderer, drawn), gradients(renderer.exact(), drawn)
        assert exact.abs().max() > 0.1
        assert (ours - exact).abs().max() < 1e-3 * exact.abs().max()
