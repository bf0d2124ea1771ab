"""The pages of a search that held because its ε bound it."""

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from httpx import ASGITransport

from services.jobs.record import Record
from services.pipeline.spec import parse
from tests.unit.api.dashboard_records import add, app, open_record, result, succeed
from tests.unit.api.test_dashboard_pages import Tags

SPEC = parse(
    {
        "scene": {"objects": [{"mesh": "furniture/grand-piano"}]},
        "attack": {
            "method": "apgd",
            "groups": ["normals", "illumination"],
            "constraint": "backtrack",
            "perceptibility": 0.05,
        },
    }
)
AT_EPSILON = {"normals": {"coordinates": 0, "share": 0.0}, "illumination": {"coordinates": 128, "share": 0.25}}
WORDS = "within ε, p used 11.70 of 50.00 ×10⁻³"


@pytest.fixture
def record(tmp_path: Path) -> Iterator[Record]:
    with open_record(tmp_path) as made:
        yield made


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.mark.anyio
@pytest.mark.parametrize("at_epsilon", [AT_EPSILON, {}], ids=["bound", "free"])
async def test_lists_pages_and_comparisons_say_what_bound_a_search_that_held(
    record: Record, at_epsilon: dict[str, object]
) -> None:
    ids = []
    for stopped in ("steps", "queries"):
        job = add(record, SPEC)
        held = {"outcome": "held", "fooled": False, "verified": False, "stopped": stopped, "at_epsilon": at_epsilon}
        succeed(record, job, result(SPEC, **held))
        ids.append(job.id)
    pages = {}
    async with httpx.AsyncClient(transport=ASGITransport(app(record)), base_url="http://dashboard") as client:
        for path in ("/", f"/jobs/{ids[0]}", f"/compare?jobs={','.join(ids)}"):
            answer = await client.get(path)
            assert answer.status_code == 200, answer.text
            pages[path] = Tags(answer.text).text.replace("\N{NO-BREAK SPACE}", " ")
    for text in pages.values():
        assert (f"held {WORDS}" in text) == bool(at_epsilon)
    sentence = "Its ε bound the search: 128 values of illumination (25.0 %) ended at it. Beyond it nothing was tried."
    assert (sentence in pages[f"/jobs/{ids[0]}"]) == bool(at_epsilon)
