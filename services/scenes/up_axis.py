"""Which way is up in a mesh file, and turns a mesh so that it is +y."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.scenes.mesh import Part


def is_z_up(data: bytes, kind: str) -> bool:
    """Whether +z is up: in every 3mf file, and in a dae file that says so. In all other formats +y is."""
    return kind == "3mf" or (kind == "dae" and re.search(rb"<up_axis>\s*Z_UP\s*<", data) is not None)


def upright(parts: tuple[Part, ...]) -> tuple[Part, ...]:
    """Returns the parts of a file in which +z is up with +y up: turned about x by −90°, which leaves them fitted."""
    found = []
    for part in parts:
        own = part.metallic_roughness
        turned = replace(part, vertices=_turned(part.vertices), normals=_turned(part.normals))
        if own is not None:
            tangents = np.concatenate([_turned(own.tangents[:, :3]), own.tangents[:, 3:]], axis=1)
            turned = replace(turned, metallic_roughness=replace(own, tangents=tangents))
        found.append(turned)
    return tuple(found)


def _turned(vectors: NDArray[Any]) -> NDArray[Any]:
    return np.stack([vectors[:, 0], vectors[:, 2], -vectors[:, 1]], axis=1)
