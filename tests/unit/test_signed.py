import re
from pathlib import Path

import pytest

from services.text import signed

ROOT = Path(__file__).parents[2]
FORMATS = re.compile(r"%\+\.\d|:\+\.\d")


@pytest.mark.parametrize(
    ("value", "form", "shown"),
    [
        (-0.0004, ".3f", "+0.000"),
        (-0.0, ".3g", "+0"),
        (-0.004, ".2f", "+0.00"),
        (-0.0006, ".3f", "-0.001"),
        (0.1204, ".3f", "+0.120"),
        (-12345.0, ".3g", "-1.23e+04"),
    ],
)
def test_what_rounds_to_zero_has_no_minus(value: float, form: str, shown: str) -> None:
    assert signed(value, form) == shown


def test_no_table_writes_signs_itself() -> None:
    files = [
        one
        for room in ("api", "client", "services")
        for one in (ROOT / room).rglob("*")
        if one.suffix in (".py", ".html")
    ]
    assert len(files) > 300
    assert [str(one.relative_to(ROOT)) for one in files if FORMATS.search(one.read_text("utf-8"))] == []
