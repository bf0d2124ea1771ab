"""Says what 32-bit coordinates have lost of a mesh that lies far from the origin.

A file in text has as many digits as its writer gave it, and is read in 64 bits. A binary STL file, most binary PLY
files and glTF hold 32-bit numbers, which are 2⁻²³ of their size apart: vertices of a mesh 1 m wide and 2,000 km from
the origin, such as one in geographical coordinates, are then on a grid of 0.125 m, and many triangles have no area.
"""

import numpy as np

from services.scenes.mesh import Doubles

FAR = 1_000.0
"""Distance from the origin, relative to the mesh's extent, beyond which rounding shows: a grid of 1e-4 of the mesh."""


def rounding_note(vertices: Doubles, declared: int, shown: int) -> str | None:
    """Returns what to say of a mesh with `declared` triangles, of which `shown` have an area; None if nothing is lost.

    vertices: finite float64 [V,3], in the file's frame. Nothing is said of coordinates that are no 32-bit numbers: they
    have more digits.
    """
    reach = float(np.abs(vertices).max())
    extent = float((vertices.max(axis=0) - vertices.min(axis=0)).max())
    if reach <= FAR * extent or not (vertices.astype(np.float32) == vertices).all():
        return None
    grid = float(np.spacing(np.float32(reach)))
    return (
        f"detail finer than {grid:.3g}: the mesh, {extent:.3g} wide, lies {reach:.3g} from the origin, and its file "
        f"holds 32-bit numbers; {declared - shown:,} of {declared:,} triangles have collapsed to nothing. Move the "
        "mesh to the origin before it is exported"
    )
