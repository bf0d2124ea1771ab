"""Tables fit the terminal, and say what they left out."""

import io

from rich.console import Console

from client.console import FittedTable
from client.tables import COLUMNS, SPARE

LONG = "normals+illumination+material"
CELLS = ["grand-piano", f"torch {LONG} fgsm", "grand piano 0.77", "upright 0.41", "fooled", "yes", "12.34", "12.30",
         "10,000", "123.4"]  # fmt: skip


def shown(width: int, columns: tuple[str, ...], rows: list[list[str]], spare: tuple[str, ...] = ()) -> list[str]:
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(FittedTable(columns, rows, spare=spare))
    return console.export_text().splitlines()


def test_several_rows_lose_the_columns_that_can_be_spared_and_say_which() -> None:
    lines = shown(80, COLUMNS, [CELLS, CELLS], SPARE)
    assert max(map(len, lines)) <= 80
    assert sum(LONG in line for line in lines) == 2  # no word is broken
    assert lines[-1] == "A wider terminal also shows: p saved, seconds, queries, verified, before."


def test_one_row_becomes_a_list_of_its_fields() -> None:
    lines = shown(60, COLUMNS, [CELLS], SPARE)
    assert max(map(len, lines)) <= 60
    for name, cell in zip(COLUMNS, CELLS, strict=True):
        assert any(name.removesuffix(">") in line and cell.split()[0] in line for line in lines), name


def test_a_wide_terminal_shows_everything() -> None:
    lines = shown(200, COLUMNS, [CELLS, CELLS], SPARE)
    assert all(any(cell in line for line in lines) for cell in CELLS)
    assert not any("A wider terminal" in line for line in lines)
