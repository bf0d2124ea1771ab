"""The base class of path tracers: plans, samples, seeds, bounces, and images that depend on their values alone."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from scene_attack.rendering.declaration import RENDERERS
from scene_attack.rendering.factory import build
from scene_attack.rendering.pyrender.path_traced import PathTracing
from scene_attack.rendering.pyrender.path_tracer import PathTracer
from scene_attack.scenes.description import DirectionalLight, Floor, Lights
from scene_attack.scenes.mesh import MetallicRoughness, TextureMap
from scene_attack.scenes.primitives import primitive
from scene_attack.scenes.resolve import with_surface
from tests.unit.path_tracing.agreement import tracer
from tests.unit.rendering import shapes

pytestmark = pytest.mark.slow

SIZE = (16, 16)


def test_the_plan_states_samples_bounces_and_errors(name: str) -> None:
    scene = shapes.placed(shapes.scene(SIZE), shapes.six_parts())
    own = tracer(name, scene, samples=4, verify_samples=64, bounces=3)
    items = {item.what: item for item in own.plan.items}
    assert (items["samples of a pixel"].kept, items["samples of a pixel"].of) == (4, 64)
    assert (items["bounces"].kept, items["denoisers"].kept) == (3, 0)
    [stage] = own.plan.stages
    assert own.plan.error_is == "mean"
    assert own.plan.error == stage.error > 0
    assert stage.evaluations == 4 * SIZE[0] * SIZE[1]
    # the error is mostly that of 4 samples, four times the standard error of 64
    stated = float(items["samples of a pixel"].why.partition("value of it is ")[2].partition(",")[0])
    images = torch.stack([own.exact().reseeded(k).render({})[0] for k in range(8)])
    covered = images.mean(dim=0)[..., 0] != scene.ground[0]
    measured = float(images.std(dim=0)[covered].square().mean().sqrt())
    assert stated == pytest.approx(measured, rel=0.2)


def test_a_plan_is_that_of_its_own_settings(name: str) -> None:
    """Jobs of one scene share what was measured for it, but not what other samples of an exact image gave."""
    scene = shapes.placed(shapes.scene(SIZE), shapes.six_parts())
    counts = []
    for verify_samples in (4, 64):
        [samples] = [i for i in tracer(name, scene, verify_samples=verify_samples).plan.items if "samples" in i.what]
        counts.append(samples.of)
    assert counts == [4, 64]
    settings = PathTracing(samples=4, verify_samples=4)
    for tolerance in (0.001, 0.002):
        assert build(scene, name, tolerance=tolerance, settings=settings).plan.tolerance == tolerance


def test_a_convex_object_alone_has_no_bounces(name: str) -> None:
    cube = primitive("cube")
    alone, floor = shapes.scene(SIZE), shapes.scene(SIZE).model_copy(update={"floor": Floor(height=-0.5)})
    thin = replace(cube, parts=(replace(cube.parts[0], color=np.array([1, 1, 1, 0.5], np.float32)),))
    assert tracer(name, shapes.placed(alone, cube), bounces=4).bounces == 0
    for scene in (
        shapes.placed(floor, cube),
        shapes.placed(alone, thin),
        shapes.placed(shapes.scene(SIZE, objects=2), cube, cube),
    ):
        assert tracer(name, scene, bounces=4).bounces == 4


def test_the_exact_twin_has_more_samples_and_seeds_of_its_own(name: str) -> None:
    own = tracer(name, shapes.placed(shapes.scene(SIZE), shapes.six_parts()), samples=4, verify_samples=32, seed=7)
    exact = own.exact()
    assert (own.samples, own.seed, exact.samples, exact.seed) == (4, 7, 32, 8)
    assert exact.exact() is exact
    assert [exact.reseeded(k).seed for k in (1, 2)] == [9, 10]
    assert exact.reseeded(1).samples == 32
    assert "4 samples, 0 bounces, seed 7" in own.backend
    assert "32 samples, 0 bounces, seed 8" in exact.backend


def test_built_exactly_it_is_its_own_twin(name: str) -> None:
    scene = shapes.placed(shapes.scene(SIZE), shapes.six_parts())
    built = build(scene, name, tolerance="exact", settings=PathTracing(verify_samples=32))
    assert isinstance(built, PathTracer)
    assert (built.exact() is built, built.samples, built.seed) == (True, 32, 1)


def test_the_same_parameters_give_the_same_bits_whatever_is_beside_them(name: str) -> None:
    own = tracer(name, shapes.placed(shapes.scene(SIZE), shapes.six_parts()), samples=4)
    random = torch.Generator().manual_seed(0)
    values = {
        group: value + 0.05 * torch.rand(3, *value.shape, generator=random, dtype=value.dtype)
        for group, value in own.initial().items()
    }
    together = own.render(values)
    assert together.dtype == torch.float32
    assert not torch.equal(together[0], together[1])
    for row in (2, 0, 1):
        assert torch.equal(own.render({g: v[row : row + 1] for g, v in values.items()})[0], together[row])


def test_what_is_not_mapped_is_said(name: str) -> None:
    texels = np.full((2, 2, 4), 200, np.uint8)
    [part] = with_surface(shapes.mesh(shapes.quad()), 0.0, 0.5).parts
    assert isinstance(part.metallic_roughness, MetallicRoughness)
    maps = {"occlusion": TextureMap(texels, 0, (10497, 10497)), "normal": TextureMap(texels, 0, (10497, 33071))}
    surface = replace(part.metallic_roughness, maps=maps)
    scene = shapes.placed(shapes.scene(SIZE), shapes.mesh(replace(part, metallic_roughness=surface)))
    said = {(item.part, item.what) for item in tracer(name, scene).plan.items}
    assert ("object 0", "occlusion maps") in said
    assert ("object 0", "textures wrapped in two ways" if name == "blender" else "normal maps") in said


def test_parallel_light_of_no_direction_lights_nothing(name: str) -> None:
    """An attack may turn a direction through zero."""
    lights = Lights(ambient=0.0, points=(), directional=(DirectionalLight(energy=3, direction=(0, -1, -1)),))
    own = tracer(name, shapes.placed(shapes.scene(SIZE, lights=lights), shapes.six_parts()), samples=4)
    values = {group: value.clone()[None] for group, value in own.initial().items()}
    assert values["illumination"].shape == (1, 5)  # the ambient light, and energy and direction of the other
    lit = own.render(values)
    values["illumination"][0, 2:] = 0
    dark = own.render(values)
    assert float(dark.min()) == 0
    assert float((lit - dark).max()) > 0.1
    values["illumination"][0, 1] = 0
    assert torch.equal(own.render(values), dark)


def test_its_groups_are_pyrender_s(name: str) -> None:
    own, pyrender = RENDERERS[name], RENDERERS["pyrender"]
    assert own.groups == pyrender.groups
    assert (own.varies, own.varied, own.worded) == (pyrender.varies, pyrender.varied, pyrender.worded)


def test_only_the_exact_twin_keeps_the_scene_s_own_image(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The cost of an image is measured with the attack's renderer at the start."""
    own = tracer(name, shapes.placed(shapes.scene(SIZE), shapes.six_parts()), samples=4, verify_samples=8)
    drawn: list[int] = []
    trace = type(own).trace
    monkeypatch.setattr(type(own), "trace", lambda self, frame: drawn.append(self.samples) or trace(self, frame))
    for renderer in (own, own.exact(), own, own.exact()):
        renderer.render({})
    assert drawn == [4, 8, 4]
    both = build(own.scene, name, tolerance="exact", settings=PathTracing(verify_samples=16))
    for _ in range(2):
        both.render({})
    assert drawn == [4, 8, 4, 16, 16]
