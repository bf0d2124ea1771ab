"""ctypes classes of the structures that the shading kernels take (`Scene` in shading.cpp and perspective.cpp)."""

import ctypes
from typing import Any


def _fields(names: str, kind: Any) -> list[tuple[str, Any]]:
    return [(name, kind) for name in names.split()]


_SIZES = [*_fields("count directions", ctypes.c_int64), *_fields("channels lobes", ctypes.c_int)]
_DISTANT = [*_SIZES, *_fields("normals towards half light base tilt log_kappa gamma", ctypes.c_void_p)]
_PERSPECTIVE = [*_SIZES, *_fields("normals viewers towards light material", ctypes.c_void_p)]
_LIMITS = "cosine_floor lowest highest"


class SceneFloat(ctypes.Structure):
    """Arguments of the shading sum for a distant viewer, float32."""

    _fields_ = [*_DISTANT, *_fields(_LIMITS, ctypes.c_float)]


class SceneDouble(ctypes.Structure):
    """Arguments of the shading sum for a distant viewer, float64."""

    _fields_ = [*_DISTANT, *_fields(_LIMITS, ctypes.c_double)]


class PerspectiveFloat(ctypes.Structure):
    """Arguments of the shading sum for a viewer at a finite distance, float32."""

    _fields_ = [*_PERSPECTIVE, *_fields(f"{_LIMITS} max_log_kappa max_log_gamma", ctypes.c_float)]


class PerspectiveDouble(ctypes.Structure):
    """Arguments of the shading sum for a viewer at a finite distance, float64."""

    _fields_ = [*_PERSPECTIVE, *_fields(f"{_LIMITS} max_log_kappa max_log_gamma", ctypes.c_double)]


STRUCTURES: dict[str, type[ctypes.Structure]] = {
    "shading.Scene.float32": SceneFloat,
    "shading.Scene.float64": SceneDouble,
    "perspective.Scene.float32": PerspectiveFloat,
    "perspective.Scene.float64": PerspectiveDouble,
}
"""The structures of this file by their names in the C++ sources. They are compared when the library is loaded;
those declared elsewhere are compared when they are first passed."""
