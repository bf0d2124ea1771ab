"""Makes the mesh of a scene's floor, in world space."""

import hashlib

import numpy as np

from services.scenes.description import Floor
from services.scenes.mesh import Mesh, Part
from services.scenes.metallic_roughness import with_surface


def floor_mesh(floor: Floor) -> Mesh:
    """Returns two triangles in world space, white, that face +y."""
    half = floor.size / 2
    corners = [(-half, floor.height, half), (half, floor.height, half), (half, floor.height, -half)]
    corners.append((-half, floor.height, -half))
    part = Part(
        vertices=np.array(corners, np.float32),
        normals=np.tile(np.array([0.0, 1.0, 0.0], np.float32), (4, 1)),
        faces=np.array([(0, 1, 2), (0, 2, 3)], np.int32),
        uv=None,
        color=np.ones(4, np.float32),
        texture=None,
    )
    digest = hashlib.sha256(part.vertices.tobytes()).hexdigest()
    return with_surface(Mesh(parts=(part,), sha256=digest, credit=None), floor.metallic, floor.roughness)
