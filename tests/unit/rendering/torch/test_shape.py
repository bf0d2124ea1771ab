"""Bent objects against scipy's splines, meshes that are bent by them, differences, and their own limits."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from torch import Tensor

import scene_attack as sa
from scene_attack.errors import InvalidRequest
from scene_attack.export.bundle import read_finished
from scene_attack.process import options
from scene_attack.rendering.declaration import BuildRequest
from scene_attack.rendering.physical_change import worded
from scene_attack.rendering.torch import bump
from scene_attack.rendering.torch.bump import UNIT
from scene_attack.rendering.torch.lattice import Lattice, Places
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.rendering.torch.shape import LARGEST, STEEPEST, Shape, limited
from scene_attack.rendering.torch.shape import bent as changed
from scene_attack.rendering.torch.table import to_angles
from scene_attack.runs.spec import parse
from scene_attack.scenes.library import Library
from scene_attack.scenes.mesh import FIT_RADIUS, Mesh
from scene_attack.scenes.resolve import ResolvedScene, resolve, with_surface_of_part
from tests.unit.rendering import dents, shapes
from tests.unit.rendering.dents import NODES
from tests.unit.rendering.torch.drill import attacked
from tests.unit.rendering.torch.test_bump import in_its_frame, vertex_normals

WAVES = ((1.0, 0.7, 0.5), (0.4, -0.9, 0.6), (-0.6, 0.5, 1.1))


def waves(height: float) -> np.ndarray:
    """Coefficients [NODES, NODES, NODES, 3] of a wave in each component, of about half the size."""
    turns = 2 * np.pi * 2.0 / (NODES - 3) * np.arange(NODES)
    return np.stack(
        [height * np.sin(np.add.outer(np.add.outer(a * turns, b * turns), c * turns)) for a, b, c in WAVES], -1
    )


def displacement(points: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Displacements [P, 3] of points [P, 3] of the object's frame."""
    return np.stack([dents.height(points, coefficients[..., k]) for k in range(3)], axis=1)


def jacobians(points: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """∂(x + d)ᵢ/∂xⱼ [P, 3, 3]."""
    return np.eye(3) + np.stack([dents.gradient(points, coefficients[..., k]) for k in range(3)], axis=1)


def before(points: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Where points [P, 3] of the bent object were."""
    found = points
    for _ in range(60):
        found = points - displacement(found, coefficients)
    return found


def bent(resolved: ResolvedScene, groups: tuple[str, ...] = ("shape",), tolerance: Any = "exact") -> TorchRenderer:
    return TorchRenderer(resolved, groups=groups, tolerance=tolerance)


def described(**scene: Any) -> ResolvedScene:
    used = options()
    request = sa.Scene.model_validate(
        {"camera": {"size": (48, 48)}, "objects": [{"mesh": "primitive/torus", "material": "matte"}]} | scene
    )
    return resolve(request, Library(used.cache_dir, used.data_dir))


def as_values(coefficients: np.ndarray) -> Tensor:
    return torch.from_numpy(coefficients)[None]


# Where points and normals go


def sphere(coefficients: np.ndarray | None, rings: int, size: int = 128) -> ResolvedScene:
    """A sphere, bent by scipy's splines, whose normals are then its triangles'."""
    part = shapes.sphere(0.8 * FIT_RADIUS, rings=rings)
    if coefficients is not None:
        vertices = part.vertices.astype(np.float64)
        vertices += displacement(vertices, coefficients)
        part = shapes.part(vertices, part.faces, vertex_normals(vertices, part.faces))
    return shapes.placed(shapes.scene((size, size)), Mesh((part,), "0" * 64, None))


def test_an_image_is_that_of_a_mesh_that_is_bent() -> None:
    """A finely divided sphere whose vertices scipy moved and whose normals are its triangles': the images differ by a
    hundredth of what the bending changes, at the outline as within it."""
    coefficients = limited(as_values(waves(LARGEST)))[0].numpy()
    plain = bent(sphere(None, 96))
    found = plain.render({"shape": as_values(coefficients)[None]})[0]
    truth = bent(sphere(coefficients, 360)).render({})[0]
    changed = (truth - plain.render({})[0]).abs().mean()
    assert float(changed) > 0.005
    assert float((found - truth).abs().mean()) < 0.02 * float(changed)
    assert float((found - truth).abs().max()) < 0.25 * float((truth - plain.render({})[0]).abs().max())


def test_vertices_and_normals_are_moved_by_the_splines() -> None:
    coefficients = waves(12.0)
    [mesh] = Shape.of(as_values(coefficients)).meshes((sphere(None, 200).meshes[0],))
    own, part = shapes.sphere(0.8 * FIT_RADIUS, rings=200), mesh.parts[0]
    count = len(own.vertices)
    points = own.vertices.astype(np.float64)
    # float32 vertices, of about 0.5
    np.testing.assert_allclose(part.vertices[:count], points + displacement(points, coefficients), atol=1e-7)
    normals = np.linalg.solve(
        jacobians(points, coefficients).transpose(0, 2, 1), own.normals.astype(np.float64)[..., None]
    )
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    np.testing.assert_allclose(part.normals[:count], normals[..., 0], atol=1e-6)
    assert abs(normals[..., 0] - own.normals).max() > 0.1


def test_tangents_lie_along_the_bent_surface() -> None:
    own = with_surface_of_part(shapes.sphere(0.8 * FIT_RADIUS, rings=200), 0.0, 0.5)
    x, z = own.normals[:, 0], own.normals[:, 2]
    across = np.hypot(x, z)
    along = np.stack([z, 0 * x, -x, across], axis=1) / np.maximum(across, 1e-6)[:, None]
    assert own.metallic_roughness is not None
    part = replace(own, metallic_roughness=replace(own.metallic_roughness, tangents=along.astype(np.float32)))
    [mesh] = Shape.of(as_values(waves(12.0))).meshes((Mesh((part,), "", None),))
    after = mesh.parts[0]
    assert after.metallic_roughness is not None
    tangents = after.metallic_roughness.tangents
    np.testing.assert_allclose((tangents[:, :3] * after.normals).sum(1), 0, atol=1e-6)
    np.testing.assert_array_equal(tangents[: len(along), 3], along[:, 3].astype(np.float32))
    assert abs(tangents[: len(along)] - along).max() > 0.05


def test_points_before_they_were_moved_are_found() -> None:
    shape = Shape.of(as_values(dents_of_all_kinds(1)))
    points = np.random.default_rng(3).uniform(-0.55, 0.55, (5_000, 3)) * FIT_RADIUS
    moved = points + displacement(points, shape.drawn[0].numpy())
    back = shape.rest(torch.from_numpy(moved), torch.zeros(5_000, dtype=torch.int64))
    np.testing.assert_allclose(back.numpy(), points, atol=1e-7)


# Limits


def dents_of_all_kinds(seed: int) -> np.ndarray:
    """The roughest coefficients that there are: each ± the largest."""
    return LARGEST * np.random.default_rng(seed).choice([-1.0, 1.0], (NODES, NODES, NODES, 3))


def rough() -> Iterator[np.ndarray]:
    for seed in (1, 4, 8):
        yield dents_of_all_kinds(seed)
    yield waves(LARGEST)
    places = np.arange(NODES)
    step = np.where(np.add.outer(np.add.outer(places, places), places) > 33, LARGEST, -LARGEST)
    yield np.stack([step, 0 * step, -step], -1)


def test_nothing_is_turned_stretched_or_moved_beyond_the_declared_range() -> None:
    points = np.random.default_rng(1).uniform(-0.99, 0.99, (30_000, 3)) * FIT_RADIUS
    normals = np.random.default_rng(2).normal(size=(30_000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    most = []
    for given in rough():
        drawn = limited(as_values(given))[0].numpy()
        assert abs(displacement(points, drawn)).max() <= LARGEST * 2 * FIT_RADIUS / 1000
        jacobian = jacobians(points, drawn)
        after = np.linalg.solve(jacobian.transpose(0, 2, 1), normals[..., None])[..., 0]
        cosines = (after * normals).sum(1) / np.linalg.norm(after, axis=1)
        assert np.degrees(np.arccos(cosines.min())) <= 30
        lengths = np.linalg.svd(jacobian, compute_uv=False)
        assert lengths.min() >= 0.5
        assert lengths.max() <= 1.5
        most.append(float(np.linalg.norm(jacobian - np.eye(3), axis=(1, 2)).max()))
    assert max(most) <= 0.5
    assert max(most) > 0.95 * STEEPEST  # no less than it may be
    declared = str(TorchRenderer.declaration.group("shape").natural_range)
    assert "36°" in declared
    assert f"{LARGEST:.0f} mm" in declared


def test_what_an_ascent_finds_between_the_limited_places_is_declared() -> None:
    """Coefficients made to be steep where nobody looks: steeper than at any limited place, and no steeper than said."""
    coarse, largest = Lattice.of(0.4), 4 * LARGEST  # as steep as a lattice of a tenth, with fewer nodes
    random = torch.Generator().manual_seed(0)
    given = largest * (2 * torch.rand(1, *[coarse.nodes] * 3, 3, dtype=torch.float64, generator=random) - 1)
    quarter = torch.full((1, 3), -0.25 * coarse.spacing, dtype=torch.float64)  # of the middle one of five cells
    places = Places.on(coarse, quarter, 0)
    for step in range(300):
        leaf = given.requires_grad_()
        steepest = torch.linalg.matrix_norm(places.gradients(limited(leaf))[0], ord=2)
        (slope,) = torch.autograd.grad(steepest, leaf)
        given = (leaf + largest * 0.985**step * slope / slope.abs().max()).clamp(-largest, largest).detach()
    found = UNIT * float(torch.linalg.matrix_norm(places.gradients(limited(given))[0], ord=2))
    assert np.sin(np.radians(33)) < found < np.sin(np.radians(36))


# Gradients


def test_gradient_is_that_of_the_normals_inside_the_outlines() -> None:
    """At a bent scene, against central differences of the image of the pixels' normals, each turned as scipy's splines
    turn that of its point."""
    size, at, h = 32, waves(5.0), 1e-5
    assert torch.equal(limited(as_values(at)), as_values(at))
    scene = described(objects=[{"mesh": "primitive/torus", "material": "plastic", "rotation": [0.4, -0.3, 1.0]}])
    direction = np.random.default_rng(0).normal(size=at.shape)
    weights = torch.randn(1, 48, 48, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(size))
    mesh_bent = replace(scene, meshes=Shape.of(as_values(at)).meshes(scene.meshes))
    there = TorchRenderer(mesh_bent, groups=("normals",), tolerance="exact")
    own, moved = in_its_frame(mesh_bent, there.bump, 0)
    points, shown = before(moved, at), there.bump.shown
    beside = abs(points).max(axis=1) > FIT_RADIUS  # the middle of a pixel at an outline may be beside the lattice
    weights.view(-1, 3)[shown.pixels[own[beside]]] = 0.0
    leaf = as_values(at)[None].requires_grad_()
    (gradient,) = torch.autograd.grad((bent(scene).render({"shape": leaf}) * weights).sum(), leaf)
    found = float((gradient * torch.from_numpy(direction)).sum())
    turn = scene.view[:3, :3].T @ scene.models[0][:3, :3] / np.linalg.norm(scene.models[0][:3, 0])
    normals = shown.normals.double().numpy()[own] @ scene.view[:3, :3] @ turn  # in the object's frame
    rest = np.linalg.solve(np.linalg.inv(jacobians(points, at)).transpose(0, 2, 1), normals[..., None])
    sides = []
    for sign in (1, -1):
        jacobian = jacobians(points, at + sign * h * direction)
        after = np.linalg.solve(jacobian.transpose(0, 2, 1), rest)[..., 0] @ turn.T
        after /= np.linalg.norm(after, axis=1, keepdims=True)
        pixels = there.initial()["normals"].reshape(-1, 2).clone()
        pixels[shown.pixels[own]] = to_angles(torch.from_numpy(after))
        sides.append(float((there.render({"normals": pixels.view(1, 48, 48, 2)}) * weights).sum()))
    wanted = (sides[0] - sides[1]) / (2 * h)
    assert abs(wanted) > 1e-4
    assert found == pytest.approx(wanted, rel=1e-5)  # depths are float32: places are off by 1e-6 of the waves
    none = as_values(0 * at)[None].requires_grad_()
    image = bent(scene).render({"shape": none})
    assert torch.equal(image.detach(), bent(scene).render({}))
    (at_rest,) = torch.autograd.grad((image * weights).sum(), none)
    assert bool(at_rest.any())


# Together with the other groups


@pytest.mark.parametrize("height", [0.0, 10.0])
@pytest.mark.parametrize("other", [None, "lamp", "illumination", "illumination_rgb", "material", "dials", "camera"])
def test_a_planned_gradient_is_the_exact_one_whatever_else_is_attacked(other: str | None, height: float) -> None:
    """Where light alone changes, factors at fixed normals are stored, and a shape would have no gradient by them."""
    scene = described()
    groups = ("shape",) if other is None else ("shape", other)
    weights = torch.randn(1, 48, 48, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    gradients = []
    for tolerance in (1e-3, "exact"):
        renderer = bent(scene, groups, tolerance)
        leaf = as_values(waves(height))[None].to(renderer.initial()["shape"].dtype).requires_grad_()
        rest = {} if other is None else {other: renderer.initial()[other][None]}
        image = renderer.render({"shape": leaf} | rest).double()
        gradients.append(torch.autograd.grad((image * weights).sum(), leaf)[0].double())
    planned, exact = gradients
    assert float((planned - exact).norm()) < 0.02 * float(exact.norm())


def test_a_shape_is_attacked_over_a_range_of_light() -> None:
    """`expectation.intensity` moves the light, so the plan is one for light."""
    ran = attacked("shape", steps=2, expectation={"intensity": 0.2, "samples": 1, "checks": 1})
    assert ran.record.trace[-1].perceptibility > 0


def test_dents_and_paint_keep_their_places_on_a_bent_object() -> None:
    """A point has the dents and the paint that it had before the object was bent."""
    scene, shape = sphere(None, 200), Shape.of(as_values(waves(LARGEST)))
    scene = replace(scene, meshes=shape.meshes(scene.meshes))
    there = TorchRenderer(scene, groups=("bump", "paint"), tolerance="exact", bent=shape)
    _, moved = in_its_frame(scene, there.bump, 0)
    points = before(moved, shape.drawn[0].numpy())
    dent = dents.random_dents(seed=3, largest=4.0)
    scale = 1000 / (2 * FIT_RADIUS)
    inside = np.linalg.norm(points, axis=1) < 0.81 * FIT_RADIUS
    np.testing.assert_allclose(
        there.bump.heights(torch.from_numpy(dent)).numpy()[inside],
        scale * dents.height(points, dent[0])[inside],
        atol=2e-3,
    )
    assert there.paint.places is there.bump.places


@pytest.mark.parametrize("others", [(), ("camera",), ("bump", "lamp")])
def test_a_bent_scene_is_drawn_with_the_other_groups(others: tuple[str, ...]) -> None:
    """As the scene of the bent mesh is, to the last bit, where no other group lies on the surface."""
    scene, shape = described(floor={"size": 6.0}, shadows={}), Shape.of(as_values(waves(10.0)))
    renderer = bent(scene, ("shape", *others))
    start = renderer.initial()
    values = {"camera": start["camera"] + 0.05, "bump": start["bump"] + 1.0, "lamp": start["lamp"] + 0.2}
    given = {group: values[group][None] for group in others}
    image = renderer.render({"shape": as_values(waves(10.0))[None]} | given)
    there = TorchRenderer(
        replace(scene, meshes=shape.meshes(scene.meshes)), groups=others or ("normals",), tolerance="exact", bent=shape
    )
    assert torch.equal(image, there.render(given))
    assert float((image - renderer.render(given)).abs().max()) > 0.05


def test_the_shadow_of_a_bent_object_is_bent() -> None:
    scene = described(floor={"size": 6.0}, shadows={}, lights={"environment": {"size": (16, 32)}})
    renderer = bent(scene)
    of_floor = renderer.bump.shown.object_index == 1
    pixels = renderer.bump.shown.pixels[of_floor & (renderer.bump.shown.share == 1)]
    both = [renderer.render(of)[0].view(-1, 3)[pixels] for of in ({}, {"shape": as_values(waves(LARGEST))[None]})]
    assert float((both[1] - both[0]).abs().max()) > 0.01


# Wavelengths


def test_longer_waves_have_fewer_values_and_are_among_the_shorter() -> None:
    """A lattice of half as many cells has functions that the finer one has too (the two-scale relation of splines)."""
    scene = described()
    renderers = [TorchRenderer(scene, groups=("bump",), tolerance="exact", wavelength=wave) for wave in (0.1, 0.2)]
    fine, coarse = (renderer.initial()["bump"] for renderer in renderers)
    assert fine.shape == (1, 23, 23, 23)
    assert coarse.shape == (1, 13, 13, 13)
    values = torch.randn(coarse.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    along = torch.zeros(23, 13, dtype=torch.float64)  # a coarse spline is (1, 4, 6, 4, 1) / 8 of fine ones
    for node in range(13):
        for step, weight in zip(range(-2, 3), (1, 4, 6, 4, 1), strict=True):
            if 0 <= (place := 2 * (node - 1) + step + 1) < 23:
                along[place, node] = weight / 8
    refined = torch.einsum("oijk,ai,bj,ck->oabc", values, along, along, along)
    images = [renderers[k].render({"bump": of[None]}) for k, of in enumerate((refined, values))]
    assert float((images[0] - images[1]).abs().max()) < 1e-9
    assert float((images[0] - renderers[0].render({})).abs().max()) > 0.001


@pytest.mark.parametrize(
    ("attack", "words"),
    [
        ({"groups": ["bump"], "wavelength": 0.05}, "attack.wavelength.*0.1"),
        (
            {"groups": ["lamp"], "wavelength": 0.2},
            "attack.wavelength: no attacked group has waves; only bump, paint, shape",
        ),
        ({"renderer": "pyrender", "method": "zoo", "wavelength": 0.2}, "no group of pyrender does"),
        ({"groups": ["normals", "shape"]}, "attack.groups: normals belong to the pixels of one"),
    ],
)
def test_what_cannot_be_attacked_is_said(attack: dict[str, Any], words: str) -> None:
    scene = {"objects": [{"mesh": "primitive/cube"}]}
    with pytest.raises(InvalidRequest, match=words):
        parse({"scene": scene, "attack": {"method": "fgsm", "renderer": "torch"} | attack})


# Results


def test_a_shape_of_unknown_size_is_said_in_parts_of_the_size() -> None:
    scene, shape = described(), Shape.of(as_values(waves(8.0)))
    [bent_by] = worded(scene, bent(scene), {"shape": shape.drawn})
    points = in_its_frame(scene, bent(scene).bump, 0)[1]
    distances = np.linalg.norm(displacement(points, waves(8.0)), axis=1) / (2 * FIT_RADIUS)
    largest = next(size for size in bent_by.sizes if size.measure == "largest distance")
    assert largest.value == pytest.approx(100 * distances.max(), rel=1e-6)
    assert largest.unit == "% of its size"
    assert bent_by.change.sentence.endswith(f" {largest.value:.2g} % of its size at most where it is seen")


@pytest.fixture(scope="module")
def result() -> sa.Result:
    return attacked("shape")


def test_a_result_says_its_shape_in_millimetres(result: sa.Result) -> None:
    [change] = result.record.change.things
    assert change.group == "shape"
    assert "mm at most" in change.sentence
    [share] = [value.after for value in change.values if value.unit == "%"]
    coefficients = result.perturbation["shape"].double()[0].numpy()
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (20_000, 3)) * FIT_RADIUS
    steepest = np.linalg.norm(jacobians(points, coefficients) - np.eye(3), axis=(1, 2)).max() / STEEPEST
    highest = abs(coefficients).max() / LARGEST
    # none of the places that are looked at is the steepest
    assert share == pytest.approx(100 * max(steepest, highest), rel=0.1)
    assert [image.file for image in change.images] == ["shape.png"]


def exported(result: sa.Result, folder: Path) -> dict[str, np.ndarray]:
    """Vertices and normals of the object in the exported scenes."""
    result.save(folder)
    files = {path.name: path.read_bytes for path in folder.iterdir()}
    used, found = options(), {}
    for which in ("before", "after"):
        (folder / "scene.glb").write_bytes(read_finished(files, Library(used.cache_dir, used.data_dir)).glb(which))
        parts = [trimesh.load_scene(folder / "scene.glb").geometry[f"object 0 part {k}"] for k in range(1)]
        found[which] = parts[0].vertices
        found[f"normals {which}"] = parts[0].vertex_normals
    return found


def test_the_exported_mesh_is_bent(result: sa.Result, tmp_path: Path) -> None:
    found = exported(result, tmp_path)
    points, count = found["before"], len(found["before"])
    drawn = limited(result.perturbation["shape"].double())[0].numpy()
    np.testing.assert_allclose(found["after"][:count], points + displacement(points, drawn), atol=1e-6)
    assert abs(found["after"][:count] - points).max() > 1e-3


def test_dents_are_exported_as_normals(tmp_path: Path) -> None:
    found = exported(attacked("bump"), tmp_path)
    count = len(found["before"])
    np.testing.assert_array_equal(found["after"][:count], found["before"])
    assert abs(found["normals after"][:count] - found["normals before"]).max() > 0.02


def test_exported_dents_are_the_normals_of_the_raised_surface() -> None:
    """Of limited dents, by scipy's splines at the vertices."""
    scene, given = described(), dents.random_dents(largest=LARGEST)
    [part], [own] = (of.meshes[0].parts for of in (changed(scene, {"bump": torch.from_numpy(given)}), scene))
    points, normals = own.vertices.astype(np.float64), own.normals.astype(np.float64)
    slopes = dents.gradient(points, bump.limited(torch.from_numpy(given))[0].numpy())
    after = normals - slopes + (slopes * normals).sum(axis=1, keepdims=True) * normals
    after /= np.linalg.norm(after, axis=1, keepdims=True)
    np.testing.assert_array_equal(part.vertices[: len(points)], own.vertices)
    np.testing.assert_allclose(part.normals[: len(points)], after, atol=1e-6)
    assert abs(after - normals).max() > 0.3


def test_words_are_of_the_shape_that_is_drawn() -> None:
    scene, given = described(), dents_of_all_kinds(1)
    renderer = bent(scene)
    [thing] = worded(scene, renderer, {"shape": as_values(given)})
    _, points = in_its_frame(scene, renderer.bump, 0)
    drawn = limited(as_values(given))[0].numpy()
    assert abs(drawn - given).max() > 1
    points = points.clip(-FIT_RADIUS, FIT_RADIUS)  # the middle of a pixel at an outline may be beside the object
    distances = 100 / (2 * FIT_RADIUS) * np.linalg.norm(displacement(points, drawn), axis=1)
    wanted = np.sqrt((distances**2).mean()), distances.max(), 100
    assert [size.value for size in thing.sizes] == pytest.approx(wanted, rel=1e-3)


def test_flat_triangles_are_divided_to_a_sixth_of_a_wave() -> None:
    [mesh] = Shape.of(as_values(waves(6.0))).meshes(described(objects=[{"mesh": "primitive/cube"}]).meshes)
    part = mesh.parts[0]
    corners = part.vertices[part.faces]
    edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=-1)
    assert edges.max() < 1.5 * 0.1 * 2 * FIT_RADIUS / 6  # nothing becomes longer by more than half


def test_a_mesh_that_would_be_divided_without_end_is_refused_by_name() -> None:
    """A thousand triangles across the whole object, which would be 4 million: refused by their number alone."""
    corners = np.random.default_rng(0).normal(size=(3_000, 3))
    corners *= FIT_RADIUS / np.linalg.norm(corners, axis=1, keepdims=True)
    part = shapes.part(corners, np.arange(3_000).reshape(-1, 3), corners / FIT_RADIUS)
    scene = shapes.placed(shapes.scene((32, 32)), Mesh((part,), "0" * 64, None))
    request = BuildRequest(scene, ("shape",), "exact", None)
    with pytest.raises(InvalidRequest, match=r"scene.objects.0.mesh.*some \d,\d+,\d+, and at most 2,000,000 are made"):
        TorchRenderer.build(request)
    TorchRenderer.build(replace(request, wavelength=0.4))


def test_the_exact_twin_has_the_same_waves() -> None:
    renderer = TorchRenderer(described(), groups=("bump",), wavelength=0.2)
    assert renderer.exact().initial()["bump"].shape == renderer.initial()["bump"].shape == (1, 13, 13, 13)
