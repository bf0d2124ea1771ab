"""The compiled library's own table of structures and functions against Python's, in agreement and damaged."""

import ctypes
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import torch

from services.rendering.kernels import build, compiled, layouts
from services.rendering.kernels.structures import STRUCTURES, PerspectiveFloat, SceneFloat

NAME = "shading.Scene.float32"


def changed(fields: list[tuple[str, Any]]) -> type[ctypes.Structure]:
    return type("Changed", (ctypes.Structure,), {"_fields_": fields})


def exports() -> layouts.Exports:
    library = compiled.library()
    assert library is not None
    return library.exports


def fields() -> list[tuple[str, Any]]:
    return [(name, kind) for name, kind, *_ in SceneFloat._fields_]


@pytest.mark.parametrize("name", STRUCTURES)
def test_structures_are_laid_out_as_the_compiler_did(name: str) -> None:
    layouts.check(STRUCTURES[name], name, exports())
    assert ctypes.sizeof(STRUCTURES[name]) == exports().structures[name].size


def test_a_reordered_field_is_named() -> None:
    swapped = fields()
    swapped[4], swapped[5] = swapped[5], swapped[4]  # both are pointers: the sizes stay as they were
    with pytest.raises(layouts.LayoutError, match=f"{NAME}.*Python has towards where .* has normals"):
        layouts.check(changed(swapped), NAME, exports())


def test_a_resized_field_is_named() -> None:
    resized = [(name, ctypes.c_int32 if name == "directions" else kind) for name, kind in fields()]
    with pytest.raises(layouts.LayoutError, match=f"{NAME}, field directions: Python has 4 bytes .* library 8"):
        layouts.check(changed(resized), NAME, exports())


def test_a_field_of_another_type_and_the_same_size_is_named() -> None:
    retyped = [(name, ctypes.c_int32 if name == "lowest" else kind) for name, kind in fields()]
    with pytest.raises(layouts.LayoutError, match=f"{NAME}, field lowest: .* library float32"):
        layouts.check(changed(retyped), NAME, exports())


def test_a_missing_field_is_named() -> None:
    with pytest.raises(layouts.LayoutError, match=f"{NAME}: Python has 14 fields where .* has 15 fields"):
        layouts.check(changed(fields()[:-1]), NAME, exports())


def test_a_structure_behind_a_pointer_is_compared_too() -> None:
    table = "structure Inner 8\nfield a 0 8 float64\nstructure Outer 8\nfield inner 0 8 Inner*\n"
    inner = changed([("a", ctypes.c_int64)])
    layouts.check(
        changed([("inner", ctypes.POINTER(changed([("a", ctypes.c_double)])))]), "Outer", layouts.parse(table)
    )
    with pytest.raises(layouts.LayoutError, match="structure Inner, field a"):
        layouts.check(changed([("inner", ctypes.POINTER(inner))]), "Outer", layouts.parse(table))
    with pytest.raises(layouts.LayoutError, match="structure Outer, field inner"):
        layouts.check(changed([("inner", ctypes.c_void_p)]), "Outer", layouts.parse(table))


@pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler")
def test_a_field_reordered_in_the_sources_is_named(tmp_path: Path) -> None:
    for path in build.SOURCES.glob("*.h"):
        shutil.copy(path, tmp_path)
    shutil.copy(build.SOURCES / "layout.cpp", tmp_path)
    source = (build.SOURCES / "perspective.cpp").read_text()
    swapped = source.replace("const T *normals, *viewers;", "const T *viewers, *normals;")
    assert swapped != source
    (tmp_path / "perspective.cpp").write_text(swapped)
    sources = [str(path) for path in tmp_path.glob("*.cpp")]
    made = tmp_path / "kernels.so"
    subprocess.run(["g++", "-std=c++17", "-fopenmp", "-shared", "-fPIC", "-w", "-o", str(made), *sources], check=True)
    table = ctypes.CDLL(str(made)).layout_table
    table.restype = ctypes.c_char_p
    with pytest.raises(layouts.LayoutError, match=r"perspective\.Scene\.float32, field normals: .* at offset 24"):
        layouts.check(PerspectiveFloat, "perspective.Scene.float32", layouts.parse(table().decode()))


def test_a_damaged_structure_never_reaches_the_kernel() -> None:
    swapped = fields()
    swapped[4], swapped[5] = swapped[5], swapped[4]
    with pytest.raises(layouts.LayoutError, match=NAME):
        compiled.call("shade", torch.float32, changed(swapped)(), torch.zeros(1, 3), compiled.threads())


@pytest.mark.parametrize(
    "angles", [torch.zeros(1, 2, dtype=torch.float64), torch.zeros(2, 2)[:, ::2], torch.zeros(1, 2, dtype=torch.int32)]
)
def test_a_tensor_of_another_kind_is_refused(angles: torch.Tensor) -> None:
    with pytest.raises(TypeError, match=r"vectors_float takes a contiguous float32\* on the CPU"):
        compiled.call("vectors", torch.float32, 1, angles, torch.zeros(1, 3), compiled.threads())


def test_a_missing_argument_is_refused() -> None:
    with pytest.raises(TypeError, match="vectors_float takes 4 arguments, not 3"):
        compiled.call("vectors", torch.float32, 1, torch.zeros(1, 2), torch.zeros(1, 3))


def test_a_table_that_cannot_be_read_is_refused() -> None:
    with pytest.raises(layouts.LayoutError, match="cannot be read: 'nonsense'"):
        layouts.parse("nonsense\n")
