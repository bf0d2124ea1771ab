"""The drawing in docs/reference/architecture.md against the imports in the code."""

import re
from pathlib import Path

import grimp
import networkx
import pytest

from tests.packages import FOLDERS

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "reference" / "architecture.md").read_text("utf-8")
DRAWN_ROOMS = dict(re.findall(r'^    (\w+)\["([\w/]+):', PAGE, re.MULTILINE))
DRAWN_ARROWS = set(re.findall(r"^    (\w+) --> (\w+)$", PAGE, re.MULTILINE))
LIBRARY = ROOT / "services" / "scene_attack"
GROUND_FLOOR = {path.stem for path in LIBRARY.glob("*.py")} - {"objects", "owner", "plugin", "__main__"}
"""Modules of the library that every room may import; the page names them in words."""


def room(module: str) -> str | None:
    """The name in the drawing of the room that a module is in; None for packages themselves and the ground floor."""
    package, *inside = module.split(".")
    if package not in ("scene_attack", "scene_attack_service"):
        return package.removeprefix("scene_attack_")
    inside = inside[1:] if inside[:1] == ["rendering"] else inside
    return None if not inside or inside[0] in GROUND_FLOOR else inside[0].strip("_")


@pytest.fixture(scope="module")
def imports() -> networkx.DiGraph:
    """Which room imports which."""
    modules = grimp.build_graph(*FOLDERS, "training")
    found = networkx.DiGraph()
    for module in modules.modules:
        here = room(module)
        if here is None:
            continue
        found.add_node(here)
        for imported in modules.find_modules_directly_imported_by(module):
            there = room(imported)
            if there is not None and there != here:
                found.add_edge(here, there)
    return found


def test_every_room_is_drawn_and_every_drawn_room_is_there(imports: networkx.DiGraph) -> None:
    assert set(DRAWN_ROOMS) == set(imports.nodes)
    for name, path in DRAWN_ROOMS.items():
        place = LIBRARY / path if path.startswith("rendering/") else ROOT / path
        assert place.is_dir() or place.with_suffix(".py").is_file(), name


def test_the_arrows_are_the_imports_without_those_that_follow(imports: networkx.DiGraph) -> None:
    assert networkx.is_directed_acyclic_graph(imports)
    assert set(networkx.transitive_reduction(imports).edges) == DRAWN_ARROWS


def test_the_ground_floor_is_named() -> None:
    for module in GROUND_FLOOR - {"__init__"}:
        assert f"`{module}`" in PAGE, module
