"""What changed, which groups did it, and the request as commands, on the page of a job."""

import pytest

from services.jobs.record import Record
from tests.unit.api.dashboard_records import add, result, row, succeed
from tests.unit.api.test_dashboard_pages import Tags, anyio_backend, get, record

__all__ = ["anyio_backend", "record"]
pytestmark = pytest.mark.anyio


async def test_changes_stand_in_words_and_in_numbers(record: Record) -> None:
    job = add(record)
    succeed(record, job, result())
    page = Tags((await get(record, f"/jobs/{job.id}")).text).text
    assert "drill moved 4.2 cm right" in page
    assert "object 0 translation x 10 14.2 +4.2 cm" in page
    assert "curl -s http://dashboard/v1/jobs -H" in page


async def test_of_a_single_group_there_is_no_plot_and_no_table_of_subsets(record: Record) -> None:
    job = add(record)
    found = result()
    found["subsets"] = [found["subsets"][0], found["subsets"][1]]
    shares = {"effect": -3.0, "shapley": [-3.0], "interactions": [[0.0]]}
    found["attribution"] = found["attribution"] | {
        "parts": ["normals"],
        "images": 0,
        "log_odds": shares,
        "probability": shares,
    }
    succeed(record, job, found)
    page = Tags((await get(record, f"/jobs/{job.id}")).text)
    assert "Which groups did it" not in page.text
    assert "Subsets of the groups" not in [a["aria-label"] for a in page.all("svg")]


async def test_the_table_behind_the_curves_of_a_long_trace_is_short(record: Record) -> None:
    job = add(record)
    succeed(record, job, result(trace=[row(step) for step in range(1002)]))
    page = Tags((await get(record, f"/jobs/{job.id}")).text).text
    assert "evenly chosen" in page
    assert "1001 2,004 250.2" in page
    assert "1000 2,002" not in page
