"""Declares the torch renderer's differentiable groups: normals, illumination (in one channel or in three), material,
dents, and the light of the room.

The paper has one intensity per direction of the environment map (footnote 1, L of W×H), so that is the default. The
module needs no torch: the API checks requests by the groups and by the names of the material presets.
"""

import json
from dataclasses import replace
from functools import lru_cache
from importlib.resources import files
from typing import Any

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.declaration import CAMERA, ROTATION, TRANSLATION, Declaration, Group, labelled, register
from scene_attack.text import did_you_mean

FEW_DEGREES = 0.0873
"""5° in radians."""

TORCH = Declaration(
    name="torch",
    groups=(
        Group(
            name="normals",
            shape=("H", "W", "2"),
            unit="radians: azimuth and polar angle in the camera's frame",
            words="surface normals",
            explanation="two free angles for every pixel: the paper's setting, not a surface one could make",
            suggested_step=0.004,
            suggested_limit=0.1,
            per_pixel=True,
        ),
        Group(
            name="illumination",
            shape=("rows", "columns"),
            unit="a tenth of the map's mean intensity, one value per texel of the environment map",
            words="illumination",
            explanation="a free intensity for every texel of the environment map: the paper's setting, not a lamp",
            vector_axes=0,
            suggested_step=0.003,
            suggested_limit=3.0,
        ),
        Group(
            name="illumination_rgb",
            shape=("rows", "columns", "3"),
            unit="a tenth of the map's mean intensity, one value per texel and channel, added to the texel's "
            "`illumination` in this channel; 0 at the start",
            words="coloured illumination",
            explanation="a free colour for every texel of the environment map, not a lamp",
            suggested_step=0.003,
            suggested_limit=3.0,
            by_default=False,
        ),
        Group(
            name="material",
            shape=("objects", "3", "3", "2", "6"),
            unit="1/30 of a natural logarithm: Bernstein coefficients of log κ and log γ, by object, channel and lobe",
            words="material",
            explanation="108 free numbers of each object's reflectance: the paper's setting, not a paint one could buy",
            labels=labelled("object {}", ("red", "green", "blue"), "lobe {}", ("kappa", "gamma"), "{}"),
            vector_axes=2,
            suggested_step=0.003,
            suggested_limit=3.0,
        ),
        Group(
            name="bump",
            shape=("objects", "nodes", "nodes", "nodes"),
            of_scene=True,
            waves=True,
            unit="thousandths of the object's size (mm at 1 m): heights of cubic B-splines on a lattice in its frame",
            words="dents",
            explanation="the height of each object's surface, the same from every view",
            vector_axes=0,
            suggested_step=0.25,
            suggested_limit=20.0,
            natural_range="20 mm at a size of 1 m, in waves of at least 100 mm, with slopes of up to 30°",
            by_default=False,
        ),
        Group(
            name="dials",
            shape=("objects", "5"),
            unit="natural ranges: +1 is highlights twice as wide, gloss twice as strong, a channel of the colour a "
            "tenth lighter; −1 is the inverse",
            words="dials of the material",
            labels=labelled("object {}", ("roughness", "gloss", "red", "green", "blue")),
            suggested_step=0.025,
            suggested_limit=1.0,
            natural_range="highlights from half to twice as wide, gloss from half to double (of a metal, no stronger), "
            "each channel of the colour within a tenth",
            by_default=False,
        ),
        Group(
            name="paint",
            shape=("objects", "nodes", "nodes", "nodes", "3"),
            waves=True,
            unit="share of the surface, by channel, that the lightest (+) or darkest (−) printable colour covers: "
            "coefficients of cubic B-splines on a lattice in the object's frame",
            words="paint",
            suggested_step=0.025,
            suggested_limit=1.0,
            natural_range="what can be printed, reflectances of 0.03 to 0.87 by channel, in waves of at least a tenth "
            "of the size",
            by_default=False,
        ),
        Group(
            name="lamp",
            shape=("7",),
            unit="shares of the natural range either way: the map's turn, brightness and colour temperature, and the "
            "power, azimuth, elevation and radius of a lamp that is added; 0 at the start",
            words="light of the room",
            labels=labelled(("turn", "brightness", "colour temperature", "power", "azimuth", "elevation", "radius")),
            vector_axes=0,
            suggested_step=0.01,
            suggested_limit=1.0,
            natural_range="the map turned by up to 30°, up to a stop brighter or darker, of 2,700 to 6,500 K; and a "
            "lamp above the horizon, of up to the map's power and 10° to 40° in radius",
            by_default=False,
        ),
        Group(
            name="shape",
            shape=("objects", "nodes", "nodes", "nodes", "3"),
            of_scene=True,
            waves=True,
            unit="thousandths of the object's size (mm at 1 m): displacements of its points by cubic B-splines on a "
            "lattice in its frame",
            words="shape",
            explanation="where each point of an object's surface is, outline and shadow with it",
            suggested_step=0.25,
            suggested_limit=20.0,
            moves=True,
            natural_range="20 mm each way at a size of 1 m, in waves of at least 100 mm, nothing turned by more than "
            "36° or longer or shorter by more than 60 %",
            by_default=False,
        ),
        replace(
            TRANSLATION,
            by_default=False,
            natural_range="0.02 scene units along each axis: 1.5 % of the size of an object of scale 1",
        ),
        replace(
            ROTATION,
            by_default=False,
            suggested_limit=FEW_DEGREES,
            natural_range="5° about each axis",
        ),
        replace(
            CAMERA,
            suggested_limit=FEW_DEGREES,
            natural_range="5° around the scene, up and down and in roll, and 0.087 scene units nearer or farther, 5 % "
            "of the usual distance",
        ),
    ),
    differentiable=True,
    method="fgsm",
    explanation="shades meshes under an environment map; exact gradients",
    renderer="scene_attack.rendering.torch.renderer:TorchRenderer",
    drawn="scene_attack.rendering.torch.words:drawn",
    remade="scene_attack.rendering.torch.shape:bent",
    worded="scene_attack.rendering.torch.words:worded",
    varies=dict.fromkeys(("azimuth", "elevation", "roll", "distance"), "camera") | {"intensity": "illumination"},
    varied="scene_attack.rendering.torch.renderer:varied",
)

register(TORCH)


@lru_cache(maxsize=1)
def stored_presets() -> dict[str, dict[str, Any]]:
    """Returns the fits of all presets by name, as presets.json has them."""
    text = files("scene_attack.rendering.torch").joinpath("presets.json").read_text()
    presets: dict[str, dict[str, Any]] = json.loads(text)["presets"]
    return presets


def check_preset(name: str, field: str = "material") -> None:
    """Raises InvalidRequest(field, …) with the nearest names for an unknown name."""
    known = stored_presets()
    if name not in known:
        hint = did_you_mean(name, known) or f"; there are {', '.join(known)}"
        raise InvalidRequest(field, f"there is no material preset {name!r}{hint}")
