"""Which texels a pixel sees: against a ball's shadow in closed form, and against rays through every triangle."""

from math import pi

import numpy as np
import pytest
import torch

from services.errors import InvalidRequest
from services.rendering.kernels import compiled
from services.rendering.opengl.gbuffer import rasterise
from services.rendering.torch_renderer.directions import directions
from services.rendering.torch_renderer.visibility import WHOLE, casters, texel_directions, visibility
from services.scenes.description import Scene, SceneObject, Shadows
from tests.unit.rendering import shapes
from tests.unit.rendering.shadow_scenes import CENTRE, RADIUS, ball, distance_to_line, ground_points, meets, over_ground

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
