"""All pages of the study."""

from pathlib import Path

from benchmarks.study.classification import CLASSIFICATION
from benchmarks.study.vqa import VQA

FOLDER = Path(__file__).parents[2] / "docs" / "study"
PAGES = (CLASSIFICATION, VQA)
NAMES = tuple(name for page in PAGES for name in page.curves)
"""The records by the names of their files."""
WITH_EXAMPLES = tuple(name for page in PAGES for name in page.with_examples)


def write(folder: Path) -> list[Path]:
    """Writes the pages that have a record in a folder, with their curves, and returns the paths of these files."""
    written = []
    for page in PAGES:
        if any((folder / f"{name}.json").exists() for name in page.curves):
            for name, text in page.files(folder).items():
                (folder / name).write_text(text, "utf-8")
                written.append(folder / name)
    return written
