"""Watertight surfaces: which faces belong to one, and that culling their backfaces changes no image."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from scene_attack.rendering.opengl import context
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.mesh import Mesh, Part
from scene_attack.scenes.solids import outsides
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


def n_watertight_faces(of: Mesh) -> int:
    return sum(count for _, count in outsides(of))


def test_a_box_of_six_parts_is_watertight_and_five_of_them_are_not() -> None:
    assert n_watertight_faces(box()) == 12
    assert n_watertight_faces(mesh(*box().parts[1:])) == 0
    assert n_watertight_faces(mesh(quad(0.5), disk(0.5, 12))) == 0


def test_transparent_surfaces_are_not_watertight() -> None:
    assert n_watertight_faces(box(color=(1, 1, 1, 0.5))) == 0
    assert n_watertight_faces(six_parts()) == 12  # textured, no texel below half alpha
    holed = six_parts()
    assert holed.parts[0].texture is not None
    holed.parts[0].texture[3, 3, 3] = 127
    assert n_watertight_faces(holed) == 0


def test_a_surface_with_one_face_turned_over_is_not_watertight() -> None:
    faces = box().parts[0].faces.copy()
    faces[0] = faces[0, ::-1]
    turned = part(box().parts[0].vertices, faces, box().parts[0].normals)
    assert n_watertight_faces(mesh(turned, *box().parts[1:])) == 0


@pytest.mark.parametrize("inverted", [False, True])
def test_watertight_faces_are_counter_clockwise_from_outside(inverted: bool) -> None:
    for one, (faces, count) in zip(box(inverted=inverted).parts, outsides(box(inverted=inverted)), strict=True):
        a, b, c = (one.vertices[faces[:, k]].astype(np.float64) for k in range(3))
        assert count == len(faces)
        assert ((np.cross(b - a, c - a) * (a + b + c)).sum(axis=1) > 0).all()


def test_watertight_surfaces_and_sheets_in_one_part_are_separated() -> None:
    round_, sheet = ball(0.3, 8), quad(0.5)
    faces = np.concatenate([sheet.faces, round_.faces + len(sheet.vertices)])
    both = part(
        np.concatenate([sheet.vertices, round_.vertices]), faces, np.concatenate([sheet.normals, round_.normals])
    )
    [(ordered, count)] = outsides(mesh(both))
    assert count == n_watertight_faces(mesh(round_)) > 0
    assert (ordered[:count] >= len(sheet.vertices)).all()
    assert {tuple(sorted(face)) for face in ordered.tolist()} == {tuple(sorted(face)) for face in faces.tolist()}


def turned(renderer: PyrenderRenderer, count: int) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return {"rotation": 2 * torch.randn((count, *renderer.initial()["rotation"].shape), generator=generator)}


@pytest.mark.parametrize("surface", [box(), six_parts(), mesh(ball())], ids=["box", "textured", "ball"])
def test_culling_backfaces_changes_no_bit(surface: Mesh, monkeypatch: pytest.MonkeyPatch) -> None:
    """The exact twin draws them behind everything, so that they show wherever the outside has a hole."""
    monkeypatch.setattr(context.Context, "software", False)  # OpenGL draws, not the rasteriser
    renderer = PyrenderRenderer(placed(scene((64, 80), azimuth=0.4, elevation=0.3), surface))
    assert renderer.watertight
    batch = turned(renderer, 6)
    assert torch.equal(renderer.radiance(batch), renderer.exact().radiance(batch))


def test_front_faces_cover_what_both_sides_cover(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same faces are drawn from both sides. Only samples at silhouettes, where both are as near, may differ."""
    surface = mesh(ball())
    renderer = PyrenderRenderer(placed(scene((96, 96), azimuth=0.4, elevation=0.3), surface))
    monkeypatch.setattr(f"{PyrenderRenderer.__module__}.MAX_BACKFACE_MISMATCH", -1.0)  # none is taken for watertight
    two_sided = PyrenderRenderer(placed(scene((96, 96), azimuth=0.4, elevation=0.3), surface))
    assert renderer.watertight
    assert not two_sided.watertight
    batch = turned(renderer, 4)
    one, other = renderer.radiance(batch), two_sided.radiance(batch)
    assert torch.equal(one[..., 3], other[..., 3])
    assert ((one - other).abs().amax(-1) > 1e-3).float().mean() < 2e-3


def test_a_camera_inside_sees_the_backfaces() -> None:
    inside = PyrenderRenderer(placed(scene((16, 16)), box(5.0)))
    assert (inside.radiance({})[..., 3] == 1).all()
    assert torch.equal(inside.radiance({}), inside.exact().radiance({}))


def test_a_surface_that_intersects_itself_is_drawn_from_both_sides() -> None:
    """One half of a bow tie is inside out: of that half only the far side would be seen."""
    bow = _bow_tie()
    crossed = PyrenderRenderer(placed(scene((48, 48), azimuth=0.6, elevation=0.2), bow))
    assert n_watertight_faces(bow) > 0
    assert not crossed.watertight


def _bow_tie() -> Mesh:
    """A tube with two capped ends over the outline of a figure of eight: one half is inside out."""
    eight = np.array([[-0.5, -0.3], [0.5, 0.3], [0.5, -0.3], [-0.5, 0.3]])
    front, back = (np.hstack([eight, np.full((4, 1), z)]) for z in (0.2, -0.2))
    corners = np.vstack([front, back])
    walls = [f for k in range(4) for f in ([k, k + 4, (k + 1) % 4], [(k + 1) % 4, k + 4, (k + 1) % 4 + 4])]
    caps = [[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]]
    return mesh(part(corners, [*walls, *caps], np.zeros((8, 3))))
