"""What comes from a service never steers the terminal, whatever an old record holds."""

import json

import pytest

from client.cli import main
from client.console import FittedTable, print_json, remark, say

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
