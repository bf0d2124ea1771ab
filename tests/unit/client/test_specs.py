import io
from pathlib import Path

import pytest

from scene_attack.cli import specs
from scene_attack.errors import InvalidRequest


def test_reads_a_file_and_puts_the_seed_over_its_own(tmp_path: Path) -> None:
    (tmp_path / "s.json").write_text('{"seed": 1, "scene": {}}')
    assert specs.read(str(tmp_path / "s.json")) == {"seed": 1, "scene": {}}
    assert specs.read(str(tmp_path / "s.json"), 9) == {"seed": 9, "scene": {}}


def test_dash_is_standard_input(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO('{"seed": 3}'))
    assert specs.read("-") == {"seed": 3}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"{", "not JSON: the name of a field, in double quotation marks, is missing at line 1, column 2"),
        (b"[]", "holds a JSON list; a spec is an object"),
        (b"\xff", "not UTF-8 text"),
        (b"[" * 200_000, "nested deeper than 64"),
        (b'{"a": ' + b"[" * 500 + b"]" * 500 + b"}", "nested deeper than 64"),
    ],
)
def test_says_what_is_wrong_with_a_file(tmp_path: Path, text: bytes, said: str) -> None:
    (tmp_path / "s.json").write_bytes(text)
    with pytest.raises(InvalidRequest, match=said) as error:
        specs.read(str(tmp_path / "s.json"))
    assert error.value.field == "SPEC"


def test_a_missing_file_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="No such file"):
        specs.read(str(tmp_path / "none.json"))
