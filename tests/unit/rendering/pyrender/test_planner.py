"""The rasterising renderer's plan, line by line: without what it keeps the image is another, with what it leaves out
it is the same to the bit."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from scene_attack.rendering.plan import ImageError
from scene_attack.rendering.pyrender import renderer as pyrender_renderer
from scene_attack.rendering.pyrender.planner import LARGEST_STEP, estimated, refusal
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import Lights, PointLight
from scene_attack.scenes.mesh import Part
from tests.unit.rendering.shapes import mesh, part, placed, quad, scene, six_parts, sphere


def shifted(of: Part, x: float) -> Part:
    return part(of.vertices + np.array([x, 0, 0]), of.faces, of.normals)


def subject(tolerance: float = 1.0) -> PyrenderRenderer:
    """A ball, which is watertight, a sheet seen from behind, a textured cube; one light of two is dark."""
    ball = sphere(0.2, 24)
    ball = shifted(part(np.round(ball.vertices, 6), ball.faces, ball.normals), -0.6)
    sheet = quad(0.2)
    sheet = shifted(part(sheet.vertices, sheet.faces[:, ::-1], sheet.normals), 0.6)
    lights = Lights(ambient=0.3, points=(PointLight(), PointLight(energy=0.0, position=(0.5, 0.5, 2.0))))
    renderer = PyrenderRenderer(
        placed(scene((48, 64), 3, lights), mesh(ball), mesh(sheet), six_parts()), tolerance=tolerance
    )
    assert renderer.rasterises == (tolerance == 1.0)  # the texture of noise is beyond 1e-4
    return renderer


def far_from(images: Tensor, others: Tensor) -> bool:
    """Whether they differ by more than the rasteriser's rules do from OpenGL's: here 1e-4 of radiance in the mean."""
    return bool((images - others).abs().mean() > 3e-4)


def image(renderer: PyrenderRenderer) -> Tensor:
    return renderer.radiance({})


def of_object(renderer: PyrenderRenderer, index: int) -> int:
    return next(i for i, piece in enumerate(renderer.drawing.pieces) if piece.index == index)


def fewer_pixels(renderer: PyrenderRenderer, patch: pytest.MonkeyPatch) -> None:
    """Three rows and columns less on every side; one is there for rounding."""
    top, bottom, left, right = renderer.extent(renderer.initial())
    patch.setattr(PyrenderRenderer, "_extent", lambda *_: (top + 3, bottom - 3, left + 3, right - 3))


def fewer_faces(renderer: PyrenderRenderer, patch: pytest.MonkeyPatch) -> None:  # noqa: ARG001
    """The sheet taken for watertight, so that its back is not drawn."""
    pieces, at = renderer.drawing.pieces, of_object(renderer, 1)
    pieces[at] = replace(pieces[at], n_watertight_faces=pieces[at].faces)


def fewer_textures(renderer: PyrenderRenderer, patch: pytest.MonkeyPatch) -> None:  # noqa: ARG001
    """The cube without its image."""
    renderer.drawing.pieces[:] = [replace(piece, texture=None) for piece in renderer.drawing.pieces]


def fewer_that_show(renderer: PyrenderRenderer, patch: pytest.MonkeyPatch) -> None:  # noqa: ARG001
    """The cube without one of the two faces of the side that faces the camera."""
    pieces, at = renderer.drawing.pieces, of_object(renderer, 2)
    pieces[at] = replace(pieces[at], triangles=pieces[at].triangles[:1].copy())


def shared_too_much(renderer: PyrenderRenderer, patch: pytest.MonkeyPatch) -> None:  # noqa: ARG001
    """The second image of a batch drawn with the pose of the first."""
    true = pyrender_renderer.shared

    def all_alike(batch, most):
        return true(batch | {"translation": np.repeat(batch["translation"][:1], len(batch["color"]), 0)}, most)

    patch.setattr(pyrender_renderer, "shared", all_alike)


@pytest.mark.parametrize("less", [fewer_pixels, fewer_faces, fewer_textures, fewer_that_show, shared_too_much])
def test_without_what_is_kept_the_image_is_another(
    less: Callable[[PyrenderRenderer, pytest.MonkeyPatch], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    renderer = subject()
    moved = torch.stack([renderer.initial()["translation"], renderer.initial()["translation"] + 0.05])
    whole = renderer.radiance({"translation": moved})
    assert not far_from(whole, renderer.exact().radiance({"translation": moved}))
    less(renderer, monkeypatch)
    assert far_from(renderer.radiance({"translation": moved}), whole)


def test_every_coordinate_that_is_kept_changes_the_image_and_no_other_does() -> None:
    renderer = subject()
    [item] = [item for item in renderer.plan.items if item.what == "coordinates"]
    start, still, changed = image(renderer), set(), 0
    for group in renderer.plan.groups:
        value = renderer.initial()[group]
        for index, name in enumerate(renderer.names(group) or []):
            sides = torch.stack([value, value])
            for row, sign in enumerate((1, -1)):
                sides[row].view(-1)[index] += sign * LARGEST_STEP
            if torch.equal(renderer.radiance({group: sides}), start.expand(2, -1, -1, -1)):
                still.add(name)
            else:
                changed += 1
    assert still == {"point 1 x", "point 1 y", "point 1 z"}  # of the dark light
    assert (changed, changed + len(still)) == (item.kept, item.of)


def test_opengl_and_faces_that_do_not_show_change_little() -> None:
    renderer = subject()
    found = {item.what: (item.kept, item.of) for item in renderer.plan.items}
    assert found["passes through OpenGL"][0] == 0 < found["passes through OpenGL"][1]
    assert 0 < found["faces shaded"][0] < found["faces shaded"][1]
    assert not far_from(image(renderer), renderer.exact().radiance({}))


def test_insides_and_the_rest_of_the_frame_change_no_bit() -> None:
    by_opengl = subject(1e-4)
    [faces] = [[item.kept, item.of] for item in by_opengl.plan.items if item.what == "faces with two sides"]
    assert 0 < faces[0] < faces[1]  # the sheet, not the ball
    [pixels] = [[item.kept, item.of] for item in by_opengl.plan.items if item.what == "pixels"]
    assert 0 < pixels[0] < pixels[1]
    assert torch.equal(by_opengl.radiance({}), by_opengl.exact().radiance({}))


@pytest.mark.parametrize(("mean", "share", "draws"), [(0.45, 0.45, True), (0.55, 0.1, False), (0.1, 0.55, False)])
def test_the_rasteriser_draws_only_if_twice_its_error_is_within_the_tolerance(
    mean: float, share: float, *, draws: bool
) -> None:
    """A tolerance t allows a mean error of t, and a share of 10 t of the pixels (docs/how-it-works.md)."""
    assert (refusal(ImageError(mean * 1e-3, share * 1e-2), (), 1e-3) is None) == draws


def test_an_estimated_share_of_pixels_is_at_most_all_of_them() -> None:
    small = estimated(ImageError(1e-4, 1e-3), 3)
    assert small.share == 1.0
    assert 2e-4 < small.mean <= 1.0
