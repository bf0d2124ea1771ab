"""The torch renderer's moved scenes against scenes that are described so, and the motion of a sphere's image."""

from math import degrees, radians, tan
from typing import Any

import pytest
import torch
from torch import Tensor

import scene_attack as sa
from scene_attack.errors import InvalidRequest, JobFailure
from scene_attack.process import options
from scene_attack.rendering.color import as_saved
from scene_attack.rendering.torch.declaration import TORCH
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.runs.spec import parse
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import ResolvedScene, resolve
from tests.unit.rendering.dents import random_dents

PLACE = {"translation": [0.125, -0.25, 0.0625], "rotation": [0.25, 0.5, -0.125]}
VIEW = {"azimuth": 0.75, "elevation": 0.25, "distance": 3.5}
"""Numbers that float32 has exactly."""


def described(thing: dict[str, Any], camera: dict[str, Any], **scene: Any) -> ResolvedScene:
    one = {"mesh": "primitive/torus", "material": "plastic"} | thing
    request = {"objects": [one], "camera": {"size": (40, 48)} | camera} | scene
    used = options()
    return resolve(sa.Scene.model_validate(request), Library(used.cache_dir, used.data_dir))


def values(of: dict[str, Any]) -> dict[str, Tensor]:
    return {group: torch.tensor(value, dtype=torch.float64) for group, value in of.items()}


ELSEWHERE = values({group: [[value]] for group, value in PLACE.items()} | {"camera": [[*VIEW.values(), 0.0]]})


@pytest.mark.parametrize("scene", [{}, {"floor": {"size": 6.0}, "shadows": {}}, {"background": {}}])
@pytest.mark.parametrize("tolerance", ["exact", 0.002])
def test_a_moved_scene_is_the_scene_that_is_described_so(scene: dict[str, Any], tolerance: Any) -> None:
    """With the dents and the light of the scene itself, to the last bit."""
    groups = ("bump", "illumination")
    own = TorchRenderer(described({}, {}, **scene), groups=(*groups, *ELSEWHERE), tolerance=tolerance)
    there = TorchRenderer(described(PLACE, VIEW, **scene), groups=groups, tolerance=tolerance)
    shared = {
        "bump": torch.from_numpy(random_dents(1, 3, 4.0))[None],
        "illumination": 1.1 * own.initial()["illumination"][None],
    }
    image = own.render(shared | ELSEWHERE)
    assert torch.equal(image, there.render(shared))
    assert float((image - own.render(shared)).abs().max()) > 0.1
    assert torch.equal(image, own.render(shared | ELSEWHERE))  # which is kept by now


def test_no_table_is_made_for_the_few_images_of_a_moved_scene() -> None:
    """Its images are then those of sums over directions, to rounding; the scene itself has tables."""
    scene = described(PLACE, VIEW | {"size": (96, 96)})
    tables, none = (TorchRenderer(scene, groups=("bump",), tolerance=0.01, few_images=few) for few in (False, True))
    found = [[recipe.method for recipe in (one.recipe for one in renderer.shaders)] for renderer in (tables, none)]
    assert found == [["cached_table"] * len(found[0]), ["summed"] * len(found[1])]
    difference = float((none.render({}) - none.exact().render({})).abs().max())
    assert difference < 1e-5 < float((tables.render({}) - tables.exact().render({})).abs().max())


def test_at_the_scenes_own_place_it_is_the_scene_itself() -> None:
    own = TorchRenderer(described(PLACE, {"azimuth": 0.3, "elevation": -0.1}), groups=tuple(ELSEWHERE))
    start = {group: own.initial()[group][None] for group in ELSEWHERE}
    assert torch.equal(own.render(start), own.render({}))
    exact = {group: value[None] for group, value in own.exact().initial().items()}
    assert torch.equal(own.exact().render(exact), own.exact().render({}))


def centre(image: Tensor, ground: Tensor) -> Tensor:
    """The middle [2] of what differs from the ground, weighted by how much, in pixels: row and column."""
    weight = (image - ground).abs().sum(-1)
    rows, columns = (torch.arange(n, dtype=torch.float64) for n in weight.shape)
    return torch.stack([(weight.sum(1) * rows).sum(), (weight.sum(0) * columns).sum()]) / weight.sum()


@pytest.mark.parametrize(
    ("group", "coordinate", "moves"),
    [
        ("translation", 0, (0.0, 1.0)),
        ("translation", 1, (-1.0, 0.0)),
        # The object is above and to the right of the middle: what turns about the camera's axis goes around it.
        ("camera", 3, (0.25, 0.25)),
    ],
)
def test_gradient_of_the_middle_of_a_sphere_is_its_motion(
    group: str, coordinate: int, moves: tuple[float, float]
) -> None:
    """A ball that moves across the line of sight by a scene unit moves by a focal length over the distance; light and
    viewer are distant, so that its shading moves with it. Perspective makes it larger off the middle: 4 %."""
    distance, field, size = 5.0, 0.5, 64
    thing = {
        "mesh": "primitive/sphere",
        "scale": 0.4,
        "translation": [0.25, 0.25, 0] if group == "camera" else [0, 0, 0],
    }
    camera = {"azimuth": 0.0, "elevation": 0.0, "distance": distance, "field_of_view": field, "size": (size, size)}
    renderer = TorchRenderer(described(thing, camera), groups=(group,), tolerance="exact")
    leaf = renderer.initial()[group][None].requires_grad_()
    ground = renderer.exact().render({})[0, 0, 0]
    for axis in range(2):
        (gradient,) = torch.autograd.grad(centre(renderer.render({group: leaf})[0], ground)[axis], leaf)
        focal = size / 2 / tan(field / 2) / distance
        wanted = focal * moves[axis]
        assert float(gradient.flatten()[coordinate]) == pytest.approx(wanted, abs=0.04 * focal)


def test_other_groups_keep_their_gradients() -> None:
    own = TorchRenderer(described({}, {}), groups=("bump", "camera"), tolerance="exact")
    there = TorchRenderer(described({}, VIEW), groups=("bump",), tolerance="exact")
    weights = torch.randn(1, 40, 48, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    found: list[Tensor] = []
    for renderer, camera in ((own, {"camera": ELSEWHERE["camera"]}), (there, {})):
        leaf = torch.zeros_like(own.initial()["bump"][None]).requires_grad_()
        found += torch.autograd.grad((renderer.render({"bump": leaf} | camera) * weights).sum(), leaf)
    assert torch.equal(*found)
    assert bool(found[0].any())


def test_what_cannot_be_drawn_is_said() -> None:
    renderer = TorchRenderer(described({}, {}), tolerance="exact")
    with pytest.raises(JobFailure, match="translation left nothing to draw"):
        renderer.render({"translation": torch.tensor([[[40.0, 0.0, 0.0]]], dtype=torch.float64)})
    normals = 0.1 + renderer.initial()["normals"][None]
    with pytest.raises(ValueError, match="pixels of one view"):
        renderer.render({"normals": normals, "camera": ELSEWHERE["camera"]})


@pytest.mark.parametrize(
    ("attack", "words"),
    [
        ({"groups": ["normals"], "expectation": {"azimuth": 30}}, "attack.expectation.azimuth: normals belong"),
        ({"groups": ["normals", "camera"]}, "attack.groups: normals belong to the pixels of one"),
    ],
)
def test_normals_of_pixels_have_one_view(attack: dict[str, Any], words: str) -> None:
    scene = {"objects": [{"mesh": "primitive/cube"}]}
    with pytest.raises(InvalidRequest, match=words):
        parse({"scene": scene, "attack": {"method": "fgsm", "renderer": "torch"} | attack})


class Brighter(torch.nn.Module):
    """Says whether an image is brighter than a level."""

    def __init__(self, level: float) -> None:
        super().__init__()
        self.level = level

    def forward(self, images: Tensor) -> Tensor:
        above = 1000 * (images.mean(dim=(1, 2, 3)) - self.level)
        return torch.stack((-above, above), dim=1)


def test_an_attack_over_views_says_from_where_it_fools() -> None:
    """Each view of the result is drawn and answered again by the renderer of a scene that is described so."""
    camera = sa.Camera(size=(48, 48), azimuth=0.5)
    scene = sa.Scene(camera=camera, objects=[sa.Object(mesh="furniture/drill", material="plastic")])
    level = float(sa.renderer(scene).render({}).mean())
    target = sa.target(
        Brighter(level - 2e-4), labels=["dark", "bright"], preprocessing=sa.Preprocessing(input_size=(48, 48))
    )
    attack = {"renderer": "torch", "method": "fgsm", "groups": ["bump"], "steps": 12}
    attack["expectation"] = {"azimuth": 180, "samples": 2, "checks": 8}
    result = sa.attack(scene, target, attack, seed=3)
    over = result.record.expectation
    assert over is not None
    assert len(over.views) == 8
    answers = []
    for view in over.views:
        there = camera.model_copy(update={"azimuth": 0.5 + radians(view.azimuth)})
        renderer = sa.renderer(scene.model_copy(update={"camera": there}), groups=["bump"], tolerance="exact")
        dents = [torch.zeros_like(renderer.initial()["bump"]), result.perturbation["bump"]]
        before, after = (
            int(target.logits(as_saved(renderer.render({"bump": value.double()[None]}))).argmax()) for value in dents
        )
        right = ["dark", "bright"][before] == result.original.label
        answers.append("wrong" if not right else "held" if before == after else "fooled")
    assert [view.answer for view in over.views] == answers
    assert len(set(answers)) > 1
    assert max(abs(view.azimuth) for view in over.views) > 90


def test_a_moved_scene_has_the_same_waves() -> None:
    own = TorchRenderer(described({}, {}), groups=("bump", "camera"), tolerance="exact", wavelength=0.2)
    there = TorchRenderer(described({}, VIEW), groups=("bump",), tolerance="exact", wavelength=0.2)
    dents = 5 * torch.randn(1, 1, 13, 13, 13, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    image = own.render({"bump": dents, "camera": ELSEWHERE["camera"]})
    assert torch.equal(image, there.render({"bump": dents}))


@pytest.mark.parametrize("group", ["camera", "rotation"])
def test_the_natural_range_of_a_turn_is_five_degrees(group: str) -> None:
    declared = TORCH.group(group)
    assert declared.suggested_limit is not None
    assert degrees(declared.suggested_limit) == pytest.approx(5, abs=0.01)
    assert "5°" in str(declared.natural_range)
