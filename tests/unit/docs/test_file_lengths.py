"""No source file has more than 300 lines, so that a reader takes it in at once."""

from pathlib import Path

ROOT = Path(__file__).parents[3]
ROOMS = ("services", "api", "worker", "client", "tests", "benchmarks", "scripts")
SUFFIXES = {".py", ".cpp", ".h", ".js", ".css", ".html", ".vert", ".frag", ""}
MAX_LINES = 300


def test_no_file_is_longer_than_the_limit() -> None:
    lines = {
        str(path.relative_to(ROOT)): path.read_text().count("\n")
        for room in ROOMS
        for path in (ROOT / room).rglob("*")
        if path.is_file()
        and path.suffix in SUFFIXES
        and not any(part.startswith(".") or part == "vendor" for part in path.relative_to(ROOT).parts)
    }
    assert len(lines) > 300  # the rooms were found
    assert {name for name, count in lines.items() if count > MAX_LINES} == set()
