"""A file that a reader takes in at once: none has more than 300 lines."""

from pathlib import Path

ROOT = Path(__file__).parents[3]
ROOMS = ("services", "api", "worker", "client", "tests", "benchmarks", "scripts")
SUFFIXES = {".py", ".cpp", ".h", ".js", ".css", ".html", ".vert", ".frag", ""}
MAX_LINES = 300
TO_BE_SPLIT = {
    "tests/unit/accuracy/test_work_precision.py",
    "tests/unit/rendering/pyrender_renderer/test_renderer.py",
    "tests/unit/rendering/torch_renderer/test_planner.py",
    "tests/unit/scenes/test_uploads.py",
}
"""Longer still. Whoever splits one takes it off this list; nothing is added."""


def test_no_file_is_longer_than_the_limit() -> None:
    lines = {
        str(path.relative_to(ROOT)): path.read_text().count("\n")
        for room in ROOMS
        for path in (ROOT / room).rglob("*")
        if path.is_file()
        and path.suffix in SUFFIXES
        and not any(part.startswith(".") for part in path.relative_to(ROOT).parts)
    }
    assert len(lines) > 300  # the rooms were found
    assert {name for name, count in lines.items() if count > MAX_LINES} == TO_BE_SPLIT
