"""Hidden faces: what is left out changes no bit of any picture, and it is most of what cannot be seen."""

from copy import copy

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from services.rendering import hidden, native
from services.rendering.hidden import Faces
from services.rendering.pyrender_plan import both_sides
from services.rendering.pyrender_renderer import PyrenderRenderer
from services.rendering.sharing import alone
from services.scenes.mesh import Mesh, Part
from tests.unit.rendering.shapes import mesh, part, placed, quad, scene, six_parts, sphere


@pytest.fixture(autouse=True)
def needs_the_loops() -> None:
    assert native.library() is not None


def looking(renderer: PyrenderRenderer) -> PyrenderRenderer:
    """The renderer, looking for hidden faces whether it pays or not."""
    twin = copy(renderer)
    twin._shown = 1
    return twin


def plain(renderer: PyrenderRenderer) -> PyrenderRenderer:
    """The renderer, drawing all faces."""
    twin = copy(renderer)
    twin._shown = None
    return twin


def left(renderer: PyrenderRenderer) -> Faces:
    """The faces that are drawn at the start."""
    [start] = alone(renderer._numbers.checked({}))
    poses = renderer._numbers.poses(start.translation, start.rotation)
    [faces] = renderer._seen([poses], [renderer._extent(poses)])
    return faces


def soup(seed: int, faces: int, size: float, color=(1, 1, 1, 1), depth: float = 0.5) -> Part:
    """Triangles anywhere, turned anyhow, each with bent normals of its own; a tenth of them twice, half thin."""
    random = np.random.default_rng(seed)
    middles = random.uniform(-0.45, 0.45, (faces, 1, 3)) * (1, 1, depth)
    corners = middles + size * random.normal(size=(faces, 3, 3))
    thin = random.random(faces) < 0.5
    corners[thin, 2] = corners[thin, 0] + 0.9 * (corners[thin, 1] - corners[thin, 0]) + 0.002 * random.normal(size=3)
    corners[: faces // 10] = corners[-(faces // 10) :]
    normals = random.normal(size=(3 * faces, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return part(corners.reshape(-1, 3), np.arange(3 * faces).reshape(-1, 3), normals, color)


def wrinkled(seed: int, rings: int) -> Part:
    """A ball with wrinkles: many small faces, some behind others at its rim."""
    one = sphere(0.5, rings)
    random = np.random.default_rng(seed)
    points = np.round(one.vertices * (1 + 0.1 * np.sin(9 * one.vertices @ random.normal(size=(3, 1)))), 5)
    return part(points, one.faces, one.normals, (0.8, 0.5, 0.3, 1))


def moved(renderer: PyrenderRenderer, seed: int, count: int = 4) -> dict[str, torch.Tensor]:
    """A few poses at random, and both sides of differences of the first pose's numbers."""
    random = torch.Generator().manual_seed(seed)
    start = renderer.initial()
    sides = both_sides(start, ("translation", "rotation"))
    for group, reach in (("translation", 0.05), ("rotation", 1.0)):
        some = reach * torch.randn(count, *start[group].shape, generator=random, dtype=torch.float64)
        sides[group] = torch.cat([sides[group][:4], start[group] + some])
    return {group: sides[group] for group in ("translation", "rotation")}


@pytest.mark.parametrize("seed", range(6))
def test_what_is_left_out_changes_no_bit(seed: int) -> None:
    things: list[Mesh] = [
        mesh(soup(seed, 4000, 0.03), soup(seed + 50, 300, 0.1, (0.9, 0.3, 0.2, 1))),
        mesh(wrinkled(seed, 60), soup(seed, 500, 0.05)),
        mesh(six_parts().parts[seed], quad(0.6, centre=(0, 0, -0.1), color=(0.2, 0.4, 1, 0.5)), wrinkled(seed, 24)),
    ]
    for thing in things:
        renderer = PyrenderRenderer(placed(scene((120, 160), azimuth=0.5 * seed, elevation=0.3), thing))
        parameters = moved(renderer, seed)
        assert torch.equal(looking(renderer).radiance(parameters), plain(renderer).radiance(parameters))
        assert len(left(renderer).triangles) < thing.triangles


def test_layers_that_a_depth_buffer_can_hardly_tell_apart_stay() -> None:
    """Triangles in one plane that faces the camera but for 3e-7 scene units; float32 has steps of 4e-6 there: rounding
    decides which of them shows."""
    random = np.random.default_rng(0)
    corners = random.uniform(-0.4, 0.4, (600, 3, 2))
    depths = np.broadcast_to(random.normal(0, 3e-7, (600, 1, 1)), (600, 3, 1))
    points = np.concatenate([corners, depths], axis=-1).reshape(-1, 3)
    normals = np.repeat(random.normal(size=(600, 3)), 3, axis=0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    layers = part(points, np.arange(1800).reshape(-1, 3), normals)
    renderer = PyrenderRenderer(placed(scene((96, 128)), mesh(layers, quad(0.1, centre=(0, 0, -0.4)))))
    parameters = moved(renderer, 0)
    assert torch.equal(looking(renderer).radiance(parameters), plain(renderer).radiance(parameters))
    assert left(renderer).counts.sum(axis=1).tolist() == [600, 0]


def test_two_objects_hide_one_another() -> None:
    front = mesh(quad(0.4, centre=(0, 0, 0.3)))
    behind = mesh(*(quad(0.05, centre=(x, y, 0)) for x in (-0.2, 0, 0.2) for y in (-0.2, 0, 0.2)))
    renderer = PyrenderRenderer(placed(scene((96, 128), 2), front, behind))
    assert left(renderer).counts.sum(axis=1).tolist() == [2] + [0] * 9
    parameters = moved(renderer, 0)
    assert torch.equal(looking(renderer).radiance(parameters), plain(renderer).radiance(parameters))


def test_what_is_inside_a_box_is_not_drawn_and_is_seen_through_glass() -> None:
    def boxed(opacity: float) -> PyrenderRenderer:
        turns = [Rotation.from_euler("y", k * np.pi / 2) for k in range(4)]
        turns += [Rotation.from_euler("x", s * np.pi / 2) for s in (1, -1)]
        sides = []
        for turn in turns:
            one = quad(0.3, centre=(0, 0, 0.3), color=(1, 1, 1, opacity))
            sides.append(part(turn.apply(one.vertices), one.faces, turn.apply(one.normals), one.color))
        ball = sphere(0.2, 32)
        inside = part(ball.vertices, ball.faces, ball.normals, (1, 0, 0, 1))
        return PyrenderRenderer(placed(scene((96, 128), azimuth=0.6, elevation=0.4), mesh(inside, *sides)))

    shut, glass = left(boxed(1.0)), left(boxed(0.5))
    faces = 4 * 32 * 32
    assert shut.counts[0].sum() < 0.4 * faces  # those beside an edge of the box, or seen edge on, are drawn
    assert 0 < shut.counts[1:].sum() <= 12
    assert glass.counts[0].sum() > 0.4 * faces
    assert glass.counts[1:].sum() == 12


def test_faces_between_the_samples_are_not_drawn() -> None:
    """Of a ball of 65,536 faces on 752 pixels of four samples each most are."""
    renderer = PyrenderRenderer(placed(scene((48, 64)), mesh(sphere(0.5, 128))))
    assert len(left(renderer).triangles) < 0.2 * renderer._drawing.pieces[0].faces


def test_with_a_face_before_the_near_plane_all_are_drawn() -> None:
    around = mesh(sphere(3.0, 24), sphere(0.2, 24))
    renderer = PyrenderRenderer(placed(scene((48, 64)), around))
    assert len(left(renderer).triangles) == around.triangles
    assert torch.equal(looking(renderer).radiance({}), plain(renderer).radiance({}))


def test_one_face_less_than_is_kept_is_another_picture() -> None:
    renderer = PyrenderRenderer(placed(scene((48, 64), azimuth=0.3, elevation=0.2), six_parts()))
    [start] = alone(renderer._numbers.checked({}))
    poses = renderer._numbers.poses(start.translation, start.rotation)
    whole, kept = (0, *renderer.size[:1], 0, *renderer.size[1:]), left(renderer)
    frames = renderer._frames(start, poses, whole, faces=kept)
    for index in range(len(kept.triangles)):
        owner = int(np.searchsorted(np.cumsum(kept.counts.sum(axis=1)), index, side="right"))
        counts = kept.counts.copy()
        counts[owner, 0 if counts[owner, 0] else 1] -= 1
        less = Faces(np.delete(kept.triangles, index, axis=0), counts)
        assert not np.array_equal(renderer._frames(start, poses, whole, faces=less), frames)


def test_it_is_done_where_it_pays_and_the_plan_says_so() -> None:
    many = PyrenderRenderer(placed(scene((96, 128)), mesh(soup(0, 3000, 0.02), quad(0.6, centre=(0, 0, 0.4)))))
    few = PyrenderRenderer(placed(scene((96, 128)), mesh(soup(0, 100, 0.05))))
    for renderer, pays in ((many, True), (few, False)):
        [item] = [item for item in renderer.plan.items if item.what == "faces"]
        of = sum(piece.faces for piece in renderer._drawing.pieces)
        assert (item.kept, item.of) == ((len(left(renderer).triangles) if pays else of), of)
        assert (item.kept <= hidden.WORTH * of) == pays
        [exact] = [item for item in renderer.exact().plan.items if item.what == "faces"]
        assert exact.kept == exact.of == of
