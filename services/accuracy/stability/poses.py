"""Where an object lands in the image after turns and moves, and how much of the ground it covers."""

from math import cos, pi, sin, tan

import numpy as np
import torch

from services.accuracy.placing import placed
from services.accuracy.stability.case import Case, Measured, need
from services.accuracy.stability.shapes import box, square
from services.accuracy.stability.views import EDGES, drawn_by
from services.rendering.factory import build
from services.rendering.opengl.gbuffer import rasterise


def _silhouette() -> Measured:
    """A black square before a white ground darkens the image by its area, whatever its edges cut.

    The camera's middle ray meets the square's middle; it is turned in its plane so that edges cross pixels at an angle.
    """
    side, distance, size = 0.7, 1.8, 24
    scene = placed(
        square(side),
        size=(size, size),
        camera={"azimuth": 0.0, "elevation": 0.0},
        thing={"color": (0, 0, 0), "rotation": (0.0, 0.0, 0.4)},
        lights={"ambient": 0.0, "points": []},
        ground=(1.0, 1.0, 1.0),
    )
    focal = size / 2 / tan(scene.description.camera.field_of_view / 2)
    area = (focal * side / distance) ** 2
    worst = 0.0
    for renderer in (*drawn_by(scene, "torch"), *drawn_by(scene, "pyrender")):
        with torch.no_grad():
            dark = float((1 - renderer.render({})[0].double()).mean(dim=2).sum())
        worst = max(worst, abs(dark / area - 1))
    return Measured(worst, EDGES, "relative error of the area, closed form; 4 and 16 samples a pixel")


def _turned(by_attack: bool) -> Measured:
    """A small cube at +x of its object lands where it must after quarter turns, seen along three axes.

    A quarter turn takes +x to +y about z, and to −z about y. −z is to the right of a camera on +x, and up for one
    straight above. `by_attack`: the turn is the attack's, not the scene's.
    """
    on_z: dict[str, float] = {"azimuth": 0.0, "elevation": 0.0}
    on_x, on_y = on_z | {"azimuth": pi / 2}, on_z | {"elevation": pi / 2}
    worst = 0.0
    for turn, camera, right, up in (
        ((0.0, 0.0, 0.0), on_z, 1, 0),
        ((0.0, 0.0, pi / 2), on_z, 0, 1),
        ((0.0, pi / 2, 0.0), on_x, 1, 0),
        ((0.0, pi / 2, 0.0), on_y, 0, 1),
    ):
        thing = {"color": (0, 0, 0), "rotation": (0.0, 0.0, 0.0) if by_attack else turn}
        dark = {"ambient": 0.0, "points": []}
        scene = placed(box((0.3, 0, 0), 0.1), size=(48, 48), camera=camera, thing=thing, lights=dark, ground=(1, 1, 1))
        given = {"rotation": torch.tensor([[turn]], dtype=torch.float64)}
        images = [one.render(given if by_attack else {})[0] for one in drawn_by(scene, "pyrender")]
        covered = [1 - image.double().mean(dim=2).numpy() for image in images]
        covered += [] if by_attack else [rasterise(scene).coverage.double().numpy()]
        offset = 24 / tan(scene.description.camera.field_of_view / 2) * 0.3 / 1.8
        for share in covered:
            need(share.sum() > 4, "it is not seen")
            rows, columns = np.mgrid[:48, :48] + 0.5
            middle = (share * columns).sum() / share.sum() - 24, 24 - (share * rows).sum() / share.sum()
            worst = max(worst, abs(middle[0] - offset * right), abs(middle[1] - offset * up))
    # The cube's near side is 3 % larger than its far side, and samples are a quarter of a pixel apart.
    return Measured(worst, 0.25, "distance of its middle from where it must be, in pixels")


def _moved_away(distance: float) -> Measured:
    """An attack moves the object out of the image, sideways and behind the camera: ground is left."""
    scene = placed(camera={"azimuth": 0.0, "elevation": 0.0})
    renderer = build(scene, "pyrender")
    moves = torch.tensor([[[distance, 0.0, 0.0]], [[0.0, 0.0, distance]], [[0.0, -distance, 0.0]]], dtype=torch.float64)
    images = renderer.render({"translation": moves})
    need(float((renderer.render({}) - torch.tensor(scene.description.ground)).abs().max()) > 0.01, "it was never there")
    ground = torch.tensor(scene.description.ground, dtype=images.dtype)
    return Measured(float((images - ground).abs().max()), 0.0, "largest difference from the ground")


def _looked_at() -> Measured:
    """An attack moves the camera, and a small cube beside the origin lands where the closed form of its view has it.

    Around, up to the bounds of the elevation, farther and nearer, and rolled over.
    """
    place, size = (0.25, 0.35, 0.0), 48
    dark = {"ambient": 0.0, "points": []}
    start = {"azimuth": 0.0, "elevation": 0.0}
    scene = placed(
        box(place, 0.1), size=(size, size), camera=start, thing={"color": (0, 0, 0)}, lights=dark, ground=(1, 1, 1)
    )
    focal = size / 2 / tan(scene.description.camera.field_of_view / 2)
    worst = 0.0
    for renderer in drawn_by(scene, "pyrender"):
        low, high = (float(bound[1]) for bound in renderer.bounds()["camera"])
        for azimuth, elevation, distance, roll in (
            (0.9, 0.0, 1.8, 0.0),
            (-2.5, low, 1.8, 0.0),
            (0.4, high, 2.4, 0.5),
            (0.0, 0.3, 1.5, -pi / 2),
        ):
            camera = torch.tensor([[azimuth, elevation, distance, roll]], dtype=torch.float64)
            share = 1 - renderer.render({"camera": camera})[0].double().mean(dim=2).numpy()
            need(share.sum() > 4, "it is not seen")
            rows, columns = np.mgrid[:size, :size] + 0.5
            x, y, _ = place
            right = x * cos(azimuth)
            up = y * cos(elevation) - x * sin(azimuth) * sin(elevation)
            depth = distance - x * sin(azimuth) * cos(elevation) - y * sin(elevation)
            wanted = right * cos(roll) + up * sin(roll), up * cos(roll) - right * sin(roll)
            middle = (share * columns).sum() / share.sum() - size / 2, size / 2 - (share * rows).sum() / share.sum()
            worst = max(worst, *(abs(m - focal * w / depth) for m, w in zip(middle, wanted, strict=True)))
    return Measured(worst, 0.25, "distance of its middle from where it must be, in pixels")


def cases() -> list[Case]:
    """The cases of this family."""
    family = "poses"
    return [
        Case("silhouette of a square", family, "edges across pixels", "the square's area", _silhouette),
        Case("turned object", family, "quarter turns, three views", "lands where it must", lambda: _turned(False)),
        Case(
            "object turned by an attack",
            family,
            "quarter turns, three views",
            "lands where it must",
            lambda: _turned(True),
        ),
        Case("camera moved by an attack", family, "to the poles, rolled over", "lands where it must", _looked_at),
        Case(
            "moved out of view",
            family,
            "a step of an attack, 1e3 away",
            "exactly the ground is left",
            lambda: _moved_away(1e3),
        ),
        Case("moved 1e15 away", family, "float32 positions", "exactly the ground is left", lambda: _moved_away(1e15)),
    ]
