"""Tables fit the terminal and say what they left out; what comes from a service never steers the terminal, whatever a
record holds.
"""

import io
import json

import pytest
from rich.console import Console

from scene_attack.cli.app import main
from scene_attack.cli.console import FittedTable, print_json, remark, say
from scene_attack.cli.tables import COLUMNS, SPARE

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


HOSTILE = "a\x1b]0;b\x07c\x1b[31md\u202ee\x9b2Jf"


def unharmed(text: str) -> bool:
    return not set("\x1b\x07\u202e\x9b") & set(text)


def test_cells_lines_and_errors_show_a_replacement(capsys: pytest.CaptureFixture[str]) -> None:
    say(FittedTable(("title", "state"), [[HOSTILE, "failed"]], title=HOSTILE), HOSTILE)
    remark(f"warning: {HOSTILE}")
    shown, said = capsys.readouterr()
    assert shown.count("c\ufffd[31md\ufffde\ufffd2Jf") == 3
    assert unharmed(shown)
    assert unharmed(said)


def test_the_words_of_an_error_too(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["scene-attack", "plan", f"{HOSTILE}.json"])
    with pytest.raises(SystemExit):
        main()
    said = capsys.readouterr().err
    assert "bad input: SPEC: cannot read a\ufffd" in said
    assert unharmed(said)


def test_json_says_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"title": HOSTILE})
    text = capsys.readouterr().out
    assert unharmed(text)
    assert json.loads(text) == {"title": HOSTILE}
