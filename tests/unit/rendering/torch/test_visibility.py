"""Which texels a pixel sees: against a ball's shadow in closed form, and against rays through every triangle."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest
import torch
from trimesh.creation import icosphere

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.kernels import compiled
from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.rendering.torch.light import directions
from scene_attack.rendering.torch.surfaces import WHOLE, casters, inner_balls, texel_directions, visibility
from scene_attack.scenes.description import Camera, Scene, SceneObject, Shadows
from scene_attack.scenes.resolve import with_surface
from scene_attack.scenes.solids import is_convex
from tests.unit.rendering import shapes
from tests.unit.rendering.shadow_scenes import (
    CENTRE,
    RADIUS,
    ball,
    distance_to_line,
    ground_points,
    meets,
    over_ground,
    square,
)

pytestmark = pytest.mark.slow

MIDDLES = Shadows(texel_samples=1)


def found(scene) -> tuple[torch.Tensor, torch.Tensor]:
    """Covered pixels [P], and their visibility [D, P]."""
    gbuffer = rasterise(scene)
    pixels = (gbuffer.coverage.flatten() > 0).nonzero()[:, 0]
    seen = visibility(scene, gbuffer.at(pixels))
    assert seen is not None
    return pixels, seen


def test_a_ball_s_shadow_on_the_ground_from_every_texel() -> None:
    """Outside 2 % of the outline, where the mesh and the ray's start count: the ball hides what its circle covers."""
    scene = over_ground(ball(), shadows=MIDDLES)
    pixels, seen = found(scene)
    points, ground, _ = (
        value.reshape(48 * 64, -1)[pixels] if value.ndim > 1 else value for value in ground_points(scene)
    )
    compared = hidden = 0
    for texel, way in enumerate(directions(16, 32).numpy()):
        if way[1] <= 0:
            assert (seen[texel][ground[:, 0]] == WHOLE).all()  # below the ground's horizon
            continue
        off = distance_to_line(points, np.broadcast_to(way, points.shape), CENTRE)
        sure = ground[:, 0] & (np.abs(off / RADIUS - 1) > 0.02)
        wanted = np.where(off < RADIUS, 0, WHOLE)
        assert (seen[texel].numpy()[sure] == wanted[sure]).all()
        compared, hidden = compared + sure.sum(), hidden + (wanted[sure] == 0).sum()
    assert compared > 1e5
    assert hidden > 1e4


def test_the_ground_hides_what_a_ball_would_mirror_of_the_map_below() -> None:
    """From the ball's points a direction downwards is hidden where its ray meets the square, which gives no light back:
    the sides of metals are dark there. Near the square's edges and the ball's horizon nothing is said."""
    pixels, seen = found(over_ground(ball(), shadows=MIDDLES, elevation=0.4))
    eye, rays = shapes.rays(over_ground(ball(), elevation=0.4).description.camera)
    rays = rays.reshape(-1, 3)[pixels]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    towards = CENTRE - eye
    along = rays @ towards
    depth = RADIUS**2 - (towards @ towards - along**2)
    on_ball = depth > (0.5 * RADIUS) ** 2  # well within its outline
    points = eye + rays[on_ball] * (along[on_ball] - np.sqrt(depth[on_ball]))[:, None]
    normals = (points - CENTRE) / RADIUS
    compared = hidden = 0
    for texel, way in enumerate(directions(16, 32).numpy()):
        if way[1] > 0:
            assert (seen[texel].numpy()[on_ball] == WHOLE).all()  # a ball hides nothing from itself
            continue
        places = np.abs((points - way * (points[:, 1:2] / way[1]))[:, [0, 2]]).max(axis=1)
        sure = (normals @ way > 0.15) & (np.abs(places - 2.0) > 0.05)
        wanted = np.where(places < 2.0, 0, WHOLE)
        assert (seen[texel].numpy()[on_ball][sure] == wanted[sure]).all()
        compared, hidden = compared + sure.sum(), hidden + (wanted[sure] == 0).sum()
    assert 2000 < hidden < compared


def test_rays_through_every_triangle_see_the_same() -> None:
    """A cube and a tilted ring of few triangles, 12 × 16 pixels, all texels of 4 × 8 with 4 directions each."""
    ring = shapes.mesh(shapes.sphere(0.3, rings=5))
    things = [(shapes.six_parts(), (0.5, 0.31, 0.2)), (ring, (-0.4, 0.4, 0.0))]
    placed = [(own, SceneObject(mesh="primitive/cube", translation=at, rotation=(0, 0.5, 0))) for own, at in things]
    scene = over_ground(*placed, shadows=Shadows(texel_samples=2), size=(12, 16))
    object.__setattr__(scene, "environment", np.ones((4, 8, 3), np.float32))
    pixels, seen = found(scene)
    triangles, owners = casters(scene)
    gbuffer = rasterise(scene)
    index = gbuffer.object_index.flatten()[pixels].numpy()
    points, ground, _ = (
        value.reshape(12 * 16, -1)[pixels] if value.ndim > 1 else value for value in ground_points(scene)
    )
    eye, rays = shapes.rays(scene.description.camera)
    rays = rays.reshape(-1, 3)[pixels]
    clear = ~meets(np.broadcast_to(eye, rays.shape), rays, triangles[owners > 0]) & (index == 0) & ground[:, 0]
    assert clear.sum() > 60
    starts = points[clear] + (0, 1e-3, 0)
    for texel, ways in enumerate(texel_directions(4, 8, 2).numpy()):
        above = ways[ways[:, 1] > 0]
        if not len(above):
            continue
        passed = np.mean([~meets(starts, np.broadcast_to(way, starts.shape), triangles) for way in above], axis=0)
        # A ray through an edge may go either way.
        off = np.abs(seen[texel].numpy()[clear] / WHOLE - passed)
        assert (off > 0.003).mean() < 0.03
    assert (seen.numpy()[:, clear] < WHOLE).mean() > 0.02


def test_a_convex_thing_alone_is_not_in_shadow() -> None:
    """Nor do the triangles of its round surface shadow their neighbours, or the pixels on its outline themselves."""
    for own in (shapes.sphere(0.5), shapes.sphere(0.5, rings=48)):
        _, seen = found(
            shapes.placed(Scene(**dict(shapes.scene(elevation=0.3)) | {"shadows": Shadows()}), shapes.mesh(own))
        )
        assert (seen == WHOLE).all()


def test_from_inside_a_ball_nothing_is_seen_past_it() -> None:
    """The camera is in it: what is convex hides nothing outside of itself only."""
    ball_mesh = icosphere(subdivisions=3, radius=3.0)
    around = shapes.mesh(shapes.part(ball_mesh.vertices, ball_mesh.faces, ball_mesh.vertices / 3.0))
    assert is_convex(around)
    description = shapes.scene((8, 12), elevation=0.3).model_copy(update={"shadows": MIDDLES})
    scene = shapes.placed(description, around)
    _, seen = found(scene)
    _, rays = shapes.rays(description.camera)
    inwards = -rays.reshape(-1, 3)  # of a ball about the origin, about: far from the horizon
    above = directions(16, 32).numpy() @ (inwards / np.linalg.norm(inwards, axis=1, keepdims=True)).T > 0.8
    assert above.sum() > 500
    assert (seen.numpy()[above] == 0).all()


def test_the_outline_of_what_is_under_a_roof_is_under_it_too() -> None:
    """Where the ray through a pixel's middle misses the ball, its depth says where the surface is, not the camera's
    place, above which there is no roof."""
    scene = over_ground(ball(), square(1.3, 0.6, (0.2, -0.1)), shadows=MIDDLES, elevation=0.15)
    gbuffer = rasterise(scene)
    pixels, seen = found(scene)
    index = gbuffer.object_index.flatten()[pixels].numpy()
    up = gbuffer.normals.reshape(-1, 3)[pixels].numpy()[:, 1] > 0.3
    eye, rays = shapes.rays(scene.description.camera)
    rays = rays.reshape(-1, 3)[pixels]
    missed = distance_to_line(np.broadcast_to(eye, rays.shape), rays, CENTRE) > RADIUS
    assert eye[1] < 1.0
    assert ((index == 1) & up & missed).sum() >= 2
    assert (seen.numpy()[:32][:, (index == 1) & up] == 0).all()  # the row of texels about the zenith


def test_the_ball_inside_a_box_touches_its_nearest_sides() -> None:
    """And there is none inside what is not convex."""
    sides = np.array([0.5, 0.2, 0.9])
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * sides
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6)]
    faces += [(0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    box = shapes.mesh(shapes.part(corners, faces, corners / np.linalg.norm(corners, axis=1, keepdims=True)))
    thing = SceneObject(mesh="primitive/cube", translation=(0.1, 1.0, 0.3), scale=2.0)
    scene = over_ground((box, thing), (shapes.six_parts(), SceneObject(mesh="primitive/cube")))
    ground, inside, parts = inner_balls(scene, *casters(scene))
    np.testing.assert_allclose(inside, (0.1, 1.0, 0.3, 2 * 0.2), rtol=2e-4, atol=1e-6)
    assert inside[3] < 2 * 0.2
    assert ground[3] == parts[3] == 0


def test_a_scene_a_twentieth_as_large_sees_the_same() -> None:
    """Two balls in one mesh, which is not convex: rays start as near to it as its scale asks for."""
    left, right = (shapes.sphere(0.3, rings=32) for _ in range(2))
    apart = np.array([0.35, 0.0, 0.0])
    pair = shapes.mesh(
        shapes.part(
            np.vstack([left.vertices - apart, right.vertices + apart]),
            np.vstack([left.faces, right.faces + len(left.vertices)]),
            np.vstack([left.normals, right.normals]),
        )
    )
    images = []
    for scale in (1.0, 0.05):
        thing = SceneObject(mesh="primitive/sphere", scale=scale)
        description = Scene(
            camera=Camera(size=(18, 24), elevation=0.5, distance=2.0 * scale), objects=(thing,), shadows=MIDDLES
        )
        images.append(found(shapes.placed(description, pair))[1])
    assert (images[0] < WHOLE).float().mean() > 0.01
    assert (images[0] != images[1]).float().mean() < 1e-3


def test_what_is_blended_casts_no_shadow() -> None:
    """A glTF part that is drawn over what is behind it, whatever its opacity."""
    own, thing = ball()
    solid = with_surface(own, 0.0, 0.5)
    surface = solid.parts[0].metallic_roughness
    assert surface is not None
    blended = replace(solid.parts[0], metallic_roughness=replace(surface, alpha_mode="BLEND"))
    for parts, owners in ((solid.parts, {0, 1}), ((blended,), {0})):
        assert set(casters(over_ground((shapes.mesh(*parts), thing)))[1].tolist()) == owners


def test_glass_casts_no_shadow() -> None:
    own, thing = ball()
    clear = shapes.mesh(shapes.sphere(RADIUS, color=(1, 1, 1, 0.5)))
    del own
    _, seen = found(over_ground((clear, thing)))
    assert (seen[:, : 48 * 64] == WHOLE).float().mean() > 0.999


def test_directions_within_a_texel_have_its_mean_and_equal_solid_angles() -> None:
    fine = texel_directions(4, 8, 32)
    assert torch.allclose(fine.norm(dim=-1), torch.ones(()).double())
    theta, phi = torch.arccos(fine[..., 1]), torch.atan2(fine[..., 0], fine[..., 2]) % (2 * pi)
    row, column = (theta / (pi / 4)).long(), (phi / (pi / 4)).long()
    assert (row * 8 + column == torch.arange(32)[:, None]).all()
    # Equal solid angles: the mean of y over the sphere's upper half, by texels' solid angles, is one half.
    areas = torch.tensor([np.cos(i * pi / 4) - np.cos((i + 1) * pi / 4) for i in range(4)]).repeat_interleave(8)
    upper = slice(0, 16)
    assert float((fine[upper, :, 1].mean(1) * areas[upper]).sum() / areas[upper].sum()) == pytest.approx(0.5, abs=1e-9)
    assert torch.allclose(texel_directions(4, 8, 1)[:, 0], directions(4, 8))


def test_without_kernels_it_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = over_ground(ball())
    gbuffer = rasterise(scene)
    monkeypatch.setattr(compiled, "library", lambda: None)
    with pytest.raises(InvalidRequest, match="compiled kernels") as refused:
        visibility(scene, gbuffer.at(torch.zeros(1, dtype=torch.int64)))
    assert refused.value.field == "scene.shadows"
