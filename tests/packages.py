"""The folders of the product's packages, by their names: those with an `__init__.py` in services, api and worker."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = {
    path.parent.name: path.parent
    for room in ("services", "api", "worker")
    for path in (ROOT / room).glob("*/__init__.py")
}
