"""The page of IEP's departures says what its result says."""

import json
from typing import Any

from benchmarks.iep_departures_page import PAGE, RESULT, page


def row(variant: str, right: int) -> dict[str, Any]:
    share = {"right": right, "of": 200, "share": right / 200, "wilson": [0.1, 0.9]}
    return {"variant": variant, "parameters": 12345, "seconds": 90.0, "overall": share, "families": {"one_hop": share}}


def test_a_row_has_shares_in_percent_and_the_difference_from_the_first() -> None:
    head = {"command": "c", "seed": 0, "backend": "cpu", "machine": "m", "versions": {"torch": "2"}}
    rows = [row("as it is", 130), row("less", 101)]
    found = page(head | {"steps": 1500, "batch": 64, "scenes": 4000, "rows": rows})
    assert "| as it is | 65.0 | 10.0 to 90.0 |  | 12,345 | 1.5 | 65.0 |" in found
    assert "| less | 50.5 | 10.0 to 90.0 | -14.5 | 12,345 | 1.5 | 50.5 |" in found


def test_the_page_is_written_from_the_committed_result() -> None:
    assert PAGE.exists() == RESULT.exists()
    if RESULT.exists():
        written = page(json.loads(RESULT.read_text("utf-8")))
        assert PAGE.read_text("utf-8") == written, "write it again with: python -m benchmarks.iep_departures_page"
