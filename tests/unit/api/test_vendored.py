"""Files of other projects are those that their table names, and load nothing but each other."""

import re
from hashlib import sha256
from pathlib import Path

import pytest

VENDOR = Path(__file__).parents[3] / "api" / "scene_attack_api" / "dashboard" / "static" / "vendor"
TABLE = dict(re.findall(r"^\| `([^`]+)` .*\| `([0-9a-f]{64})` \|$", (VENDOR / "VENDORED.md").read_text(), re.MULTILINE))


def test_every_file_is_in_the_table_with_its_hash() -> None:
    files = {str(path.relative_to(VENDOR)): path for path in VENDOR.rglob("*") if path.is_file()}
    del files["VENDORED.md"]
    assert {name: sha256(path.read_bytes()).hexdigest() for name, path in files.items()} == TABLE


@pytest.mark.parametrize("name", [name for name in TABLE if name.endswith(".js")])
def test_a_module_imports_its_neighbours_alone(name: str) -> None:
    imported = re.findall(r"""\bfrom\s*["']([^"']+)["']|\bimport\s*["']([^"']+)["']""", (VENDOR / name).read_text())
    for found in imported:
        assert ((VENDOR / name).parent / "".join(found)).is_file(), found
