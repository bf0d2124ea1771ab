"""The compiled library's own table of structures and functions, and what is passed by it, right and wrong."""

import ctypes
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from scene_attack.rendering.kernels import compiled

pytestmark = pytest.mark.slow

SOURCES = Path(compiled.__file__).with_name("src")

TABLE = """structure Inner 16
field a 0 8 float64
field n 8 4 int32
structure Outer 56
field count 0 8 int64
field row 8 8 float32*
field rows 16 8 float32**
field inner 24 8 Inner*
field one 32 16 Inner
field pair 48 8 float32[2]
"""


TABLED = compiled.parse(TABLE)


def outer(**changed: object) -> Any:
    """A structure `Outer`, its values in an order of their own; `...` leaves one out."""
    inner = [compiled.make_structure(TABLED, "Inner", n=n, a=n / 2) for n in (1, 2)]
    row = np.arange(3, dtype=np.float32)
    values: dict[str, object] = {"one": inner[0], "pair": [5, 6], "inner": inner, "rows": [row + 1, row + 2]}
    values |= {"row": row, "count": 3, **changed}
    given = {name: value for name, value in values.items() if value is not ...}
    return compiled.make_structure(TABLED, "Outer", **given)


def exports() -> compiled.Exports:
    library = compiled.library()
    assert library is not None
    return library.exports


def test_the_librarys_structures_are_laid_out_as_the_compiler_did() -> None:
    assert {"Texture", "Piece", "Frame", "Pass", "shading.Scene.float", "shading.Scene.double"} <= set(
        exports().structures
    )


def test_a_structure_points_to_what_it_was_given() -> None:
    made = outer()
    assert (made.count, made.one.a, made.one.n, list(made.pair)) == (3, 0.5, 1, [5, 6])
    assert (ctypes.c_float * 3).from_address(made.row)[2] == 2
    second = (ctypes.c_void_p * 2).from_address(made.rows)[1]
    assert second is not None
    assert (ctypes.c_float * 3).from_address(second)[0] == 2
    kind = type(made.one)
    assert [one.n for one in (kind * 2).from_address(made.inner)] == [1, 2]


def test_none_is_a_null_pointer() -> None:
    assert outer(row=None).row is None


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"row": ...}, "structure Outer: row is missing"),
        ({"sum": 1}, "structure Outer: sum is not one of count, row"),
        ({"row": np.zeros(3)}, r"Outer.row takes float32\*, contiguous and on the CPU, not float64"),
        ({"row": np.zeros((3, 2), np.float32)[:, 0]}, r"Outer.row takes float32\*.* strides \(8,\)"),
        ({"row": torch.zeros(3, device="meta")}, r"Outer.row takes float32\*, contiguous and on the CPU.* on meta"),
        ({"rows": [np.zeros(3, np.int32)]}, r"Outer.rows takes float32\*"),
        ({"pair": [1, 2, 3]}, "Outer.pair takes 2 numbers, not 3"),
        ({"count": np.zeros(2)}, "Outer.count takes int64, .* not float64"),
    ],
)
def test_a_field_that_is_wrong_is_named(changed: dict[str, object], said: str) -> None:
    with pytest.raises(TypeError, match=said):
        outer(**changed)


def test_a_structure_of_another_kind_is_refused() -> None:
    with pytest.raises(TypeError, match=r"Outer\.one takes Inner, not a structure Outer"):
        outer(one=outer())


@pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler")
def test_a_field_moved_in_the_sources_is_moved_here(tmp_path: Path) -> None:
    for pattern in ("*.h", "layout.cpp", "perspective*.cpp"):
        for path in SOURCES.glob(pattern):
            shutil.copy(path, tmp_path)
    source = (tmp_path / "perspective.h").read_text()
    swapped = source.replace("const T *normals, *viewers;", "const T *viewers, *normals;")
    assert swapped != source
    (tmp_path / "perspective.h").write_text(swapped)
    sources = [str(path) for path in tmp_path.glob("*.cpp")]
    made = tmp_path / "kernels.so"
    subprocess.run(["g++", "-std=c++17", "-fopenmp", "-shared", "-fPIC", "-w", "-o", str(made), *sources], check=True)
    table = ctypes.CDLL(str(made)).layout_table
    table.restype = ctypes.c_char_p
    name = "perspective.Scene.float"
    here, there = (found.structures[name].kind for found in (exports(), compiled.parse(table().decode())))
    fields: list[tuple[Any, Any]] = [(kind.normals, kind.viewers) for kind in (here, there)]  # type: ignore[attr-defined]
    assert [(normals.offset, viewers.offset) for normals, viewers in fields] == [(24, 32), (32, 24)]


@pytest.mark.parametrize(
    "angles", [torch.zeros(1, 2, dtype=torch.float64), torch.zeros(2, 2)[:, ::2], torch.zeros(1, 2, dtype=torch.int32)]
)
def test_a_tensor_of_another_kind_is_refused(angles: torch.Tensor) -> None:
    with pytest.raises(TypeError, match=r"vectors_float takes float32\*, contiguous and on the CPU"):
        compiled.call("vectors", torch.float32, 1, angles, torch.zeros(1, 3), compiled.threads())


def test_a_missing_argument_is_refused() -> None:
    with pytest.raises(TypeError, match="vectors_float takes 4 arguments, not 3"):
        compiled.call("vectors", torch.float32, 1, torch.zeros(1, 2), torch.zeros(1, 3))


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("nonsense\n", "cannot be read: 'nonsense'"),
        ("field a 0 8 float64\n", "cannot be read: 'field a 0 8 float64'"),
        ("structure S 8\nstructure S 8\n", "cannot be read: 'structure S 8'"),
        ("structure S 8\nfield a 0 8 float80\n", "a type that is not known: float80"),
        (
            "structure S 12\nfield a 0 4 int32\nfield b 4 8 int64\n",
            "S, field b: ctypes has 8 bytes at offset 8, .* at 4",
        ),
        ("structure S 24\nfield a 0 8 int64\n", "structure S: ctypes has 8 bytes, the compiled library 24"),
    ],
)
def test_a_table_that_cannot_be_right_is_refused(table: str, said: str) -> None:
    with pytest.raises(compiled.LayoutError, match=said):
        compiled.parse(table)
