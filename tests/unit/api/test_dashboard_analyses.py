"""Analyses and both p on the job page, rendered from a real record."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from services.jobs.record import Record
from services.pipeline.result import Result
from tests.unit.api.dashboard_records import ATTRIBUTION, add, open_record, result, succeed
from tests.unit.api.test_dashboard_pages import Tags, get

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture
def record(tmp_path: Path) -> Iterator[Record]:
    with open_record(tmp_path) as empty:
        yield empty


ANALYSES = {
    "coordinates": ATTRIBUTION
    | {
        "method": "sampled",
        "orders": 12,
        "log_odds": {"effect": -3.0, "shapley": [-2.5, -0.5], "standard_error": [0.125, 0.0625]},
    },
    "minimal": {
        "smallest": {
            "scale": 0.25,
            "label": "upright",
            "confidence": 0.5,
            "goal_probability": 0.3,
            "float_perceptibility": 0.002,
            "perceptibility": 0.003,
            "fooled": True,
        },
        "holds_at": 0.2,
        "fools_from": 0.75,
        "scan": [],
        "images": 24,
        "change": [
            {"group": "rotation", "subject": "object 0", "measure": "angle", "value": 1.5, "unit": "degrees"},
        ],
        "stored_change": [
            {"group": "rotation", "subject": "object 0", "measure": "angle", "value": 6.0, "unit": "degrees"},
        ],
    },
    "transfer": [
        {
            "target": name,
            "renderer": "torch",
            "before": {"label": "piano", "confidence": 0.9},
            "after": {"label": "<desk>", "confidence": 0.4},
            "outcome": outcome,
            "right_before": right,
            "note": "",
        }
        for name, right, outcome in (("a", True, "fooled"), ("b", False, "still-wrong"), ("c", None, "changed"))
    ],
    "interpretation": {
        "image": {"label": "upright", "confidence": 0.5},
        "scene": {"label": "piano", "confidence": 0.9},
        "fits": [
            {
                "optimiser": "sgd",
                "rate": 1e-4,
                "losses": [0.005, 0.004, 0.0045],
                "after": {"label": "piano", "confidence": 0.8},
                "distance": 0.01,
            }
        ],
    },
    "adaptive": {
        "fooled": False,
        "steps": 10,
        "goal_probability": [0.9, 0.8],
        "image": {"label": "desk", "confidence": 0.7},
        "rerendered": {"label": "piano", "confidence": 0.8},
        "perceptibility": 0.025,
    },
    "rerendering": {
        "optimiser": "adam",
        "rate": 1e-3,
        "losses": [0.006, 0.005],
        "before": {"label": "upright", "confidence": 0.5},
        "after": {"label": "piano", "confidence": 0.9},
        "distance": 0.012,
    },
}


async def test_job_page_shows_the_analyses_that_were_asked_for(record: Record) -> None:
    job = add(record)
    succeed(record, job, result(analyses=ANALYSES))
    text = Tags((await get(record, f"/jobs/{job.id}")).text).text
    for words in (
        "Shapley values of the coordinates, means over 12 random orders",
        "normals -2.500 ± 0.125",
        "at 25.0 % of the stored perturbation the network says upright (50.0 %), p = 2.00 (3.00 as saved) × 10⁻³",
        "at 20.0 % it held. Every scanned scale from 75.0 % on fools.",
        "rotation, object 0 angle 1.5 6 degrees",
        "a torch piano 90.0 % <desk> 40.0 % fooled",
        "b torch piano 90.0 % <desk> 40.0 % still-wrong",
        "c torch piano 90.0 % <desk> 40.0 % changed truth unknown",
        "sgd 1.0e-04 5.000 4.000 piano 80.0 %",
        "fell from 6.000 to 5.000 × 10⁻³",
        "after 10 steps, at p = 25.00 × 10⁻³ as saved, the network says desk 70.0 % of the image",
        "the defence held",
    ):
        assert words in text, words


async def test_job_page_shows_the_range_and_the_surrogates_queries(record: Record) -> None:
    job = add(record)
    over = {
        "variations": 100,
        "right": 80,
        "fooled": 60,
        "share": 0.75,
        "interval": [0.645, 0.832],
        "wrong_share": 0.2,
        "wrong_interval": [0.133, 0.289],
    }
    whole = result(expectation=over, surrogate_queries=1234)
    whole["provenance"] |= {"surrogate_sha256": "5" * 64}
    succeed(record, job, Result.model_validate(whole).model_dump(mode="json"))
    text = Tags((await get(record, f"/jobs/{job.id}")).text).text
    for words in (
        "and 1,234 queries of the surrogate",
        "Of 100 fresh variations of the scene the network has 80 right without the perturbation; with it, it is fooled "
        "on 60 of these: 75.0 % (64.5 % to 83.2 %",
        "It is wrong without any perturbation on 20.0 % (13.3 % to 28.9 %)",
        "Weights of the surrogate " + "5" * 64,
    ):
        assert words in text, words
