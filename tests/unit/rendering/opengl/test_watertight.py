import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from services.rendering.opengl import context
from services.rendering.opengl.watertight import outsides
from services.rendering.pyrender_renderer.renderer import PyrenderRenderer
from services.scenes.mesh import Mesh, Part
from tests.unit.rendering.shapes import disk, mesh, part, placed, quad, scene, six_parts, sphere


def box(width: float = 0.3, color: tuple[float, ...] = (1, 1, 1, 1), inverted: bool = False) -> Mesh:
    """Six squares with corners of their own, each a part, wound outward unless `inverted`."""
    sides = []
    for turn in [Rotation.from_euler("y", k * np.pi / 2) for k in range(4)] + [
        Rotation.from_euler("x", s * np.pi / 2) for s in (1, -1)
    ]:
        one = quad(width, centre=(0, 0, width), color=color)
        corners = np.round(turn.apply(one.vertices), 6)
        sides.append(part(corners, one.faces[:, ::-1] if inverted else one.faces, turn.apply(one.normals), color))
    return mesh(*sides)


def ball(radius: float = 0.5, rings: int = 48) -> Part:
    """A sphere whose seam and poles meet to the bit; it has a fan of lines at each pole."""
    one = sphere(radius, rings)
    return part(np.round(one.vertices, 6), one.faces, one.normals)


def closed(thing: Mesh) -> int:
    return sum(count for _, count in outsides(thing))


def test_a_box_of_six_parts_is_closed_and_a_side_less_is_not() -> None:
    assert closed(box()) == 12
    assert closed(mesh(*box().parts[1:])) == 0
    assert closed(mesh(quad(0.5), disk(0.5, 12))) == 0


def test_what_can_be_seen_through_is_not_closed() -> None:
    assert closed(box(color=(1, 1, 1, 0.5))) == 0
    assert closed(six_parts()) == 12  # textured, no texel below half alpha
    holed = six_parts()
    assert holed.parts[0].texture is not None
    holed.parts[0].texture[3, 3, 3] = 127
    assert closed(holed) == 0


def test_one_face_turned_over_opens_a_surface() -> None:
    faces = box().parts[0].faces.copy()
    faces[0] = faces[0, ::-1]
    turned = part(box().parts[0].vertices, faces, box().parts[0].normals)
    assert closed(mesh(turned, *box().parts[1:])) == 0


@pytest.mark.parametrize("inverted", [False, True])
def test_faces_come_back_counter_clockwise_from_outside(inverted: bool) -> None:
    for one, (faces, count) in zip(box(inverted=inverted).parts, outsides(box(inverted=inverted)), strict=True):
        a, b, c = (one.vertices[faces[:, k]].astype(np.float64) for k in range(3))
        assert count == len(faces)
        assert ((np.cross(b - a, c - a) * (a + b + c)).sum(axis=1) > 0).all()


def test_closed_surfaces_and_sheets_in_one_part_are_told_apart() -> None:
    round_, sheet = ball(0.3, 8), quad(0.5)
    faces = np.concatenate([sheet.faces, round_.faces + len(sheet.vertices)])
    both = part(
        np.concatenate([sheet.vertices, round_.vertices]), faces, np.concatenate([sheet.normals, round_.normals])
    )
    [(ordered, count)] = outsides(mesh(both))
    assert count == closed(mesh(round_)) > 0
    assert (ordered[:count] >= len(sheet.vertices)).all()
    assert {tuple(sorted(face)) for face in ordered.tolist()} == {tuple(sorted(face)) for face in faces.tolist()}


def turned(renderer: PyrenderRenderer, count: int) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return {"rotation": 2 * torch.randn((count, *renderer.initial()["rotation"].shape), generator=generator)}


@pytest.mark.parametrize("thing", [box(), six_parts(), mesh(ball())], ids=["box", "textured", "ball"])
def test_leaving_insides_out_changes_no_bit(thing: Mesh, monkeypatch: pytest.MonkeyPatch) -> None:
    """The twin draws them, behind everything: they would show wherever the outside had a hole."""
    monkeypatch.setattr(context.Context, "software", False)  # OpenGL draws, not the rasteriser
    renderer = PyrenderRenderer(placed(scene((64, 80), azimuth=0.4, elevation=0.3), thing))
    assert renderer.closed
    batch = turned(renderer, 6)
    assert torch.equal(renderer.radiance(batch), renderer.exact().radiance(batch))


def test_an_outside_covers_what_both_sides_cover() -> None:
    """Against the same faces drawn as sheets: only samples at silhouettes, where both sides are as near, may differ."""
    thing = mesh(ball())
    renderer = PyrenderRenderer(placed(scene((96, 96), azimuth=0.4, elevation=0.3), thing))
    natural = PyrenderRenderer(placed(scene((96, 96), azimuth=0.4, elevation=0.3), thing))
    natural._closed = False
    batch = turned(renderer, 4)
    one, other = renderer.radiance(batch), natural.radiance(batch)
    assert torch.equal(one[..., 3], other[..., 3])
    assert ((one - other).abs().amax(-1) > 1e-3).float().mean() < 2e-3


def test_the_inside_shows_to_a_camera_inside() -> None:
    inside = PyrenderRenderer(placed(scene((16, 16)), box(5.0)))
    assert (inside.radiance({})[..., 3] == 1).all()
    assert torch.equal(inside.radiance({}), inside.exact().radiance({}))


def test_a_surface_that_passes_through_itself_is_drawn_from_both_sides() -> None:
    """One half of a bow tie has its outside inside: of it only the far side would be seen."""
    bow = _bow_tie()
    crossed = PyrenderRenderer(placed(scene((48, 48), azimuth=0.6, elevation=0.2), bow))
    assert closed(bow) > 0
    assert not crossed.closed


def _bow_tie() -> Mesh:
    """A tube over the outline of a figure of eight with two capped ends: one half has its outside inside."""
    eight = np.array([[-0.5, -0.3], [0.5, 0.3], [0.5, -0.3], [-0.5, 0.3]])
    front, back = (np.hstack([eight, np.full((4, 1), z)]) for z in (0.2, -0.2))
    corners = np.vstack([front, back])
    walls = [f for k in range(4) for f in ([k, k + 4, (k + 1) % 4], [(k + 1) % 4, k + 4, (k + 1) % 4 + 4])]
    caps = [[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]]
    return mesh(part(corners, [*walls, *caps], np.zeros((8, 3))))
