"""The report: what it says, how it ends, and that the committed one is whole."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from scene_attack.cli.app import app
from scene_attack.errors import InvalidRequest, JobFailure
from scene_attack_accuracy.stability import report as stability
from scene_attack_accuracy.stability.case import Case, Measured, need, observe
from scene_attack_accuracy.stability.report import Report, markdown

COMMITTED = Path(__file__).parents[3] / "docs" / "accuracy"


def case(measure, **more) -> Case:
    return Case("a name", "what is stiff", "what must hold", measure, **more)


def raising(error):
    def measure() -> Measured:
        raise error

    return measure


@pytest.mark.parametrize(
    ("made", "outcome"),
    [
        (case(lambda: Measured(1.0, 1.0, "a number")), "ok"),
        (case(lambda: Measured(1.1, 1.0, "a number")), "failed"),
        (case(lambda: Measured(float("nan"), 1.0, "a number")), "failed"),
        (case(lambda: Measured(0.0, 1.0, "a number"), held="flat"), "flat"),
        (case(lambda: Measured(2.0, 1.0, "a number"), held="clipped"), "failed"),
        (case(lambda: Measured(0.0, 1.0, "a number"), refusal="file"), "failed"),
        (case(raising(InvalidRequest("file", "why")), refusal="file"), "refused"),
        (case(raising(InvalidRequest("kind", "why")), refusal="file"), "failed"),
        (case(raising(InvalidRequest("file", "")), refusal="file"), "failed"),
        (case(raising(JobFailure("non-finite", "why")), refusal="non-finite"), "refused"),
        (case(raising(InvalidRequest("file", "why"))), "failed"),
        (case(raising(ZeroDivisionError())), "failed"),
        (case(lambda: Measured(float(np.float32(3e38) * np.float32(10) > 0), 1.0, "an overflow")), "failed"),
    ],
)
def test_outcomes(made: Case, outcome: str) -> None:
    assert observe(made).outcome == outcome


def test_the_reason_of_a_failure_is_kept() -> None:
    seen = observe(case(lambda: need(False, "the image is blue")))
    assert (seen.outcome, seen.what) == ("failed", "the image is blue")


def test_the_command_ends_with_1_and_the_reason_when_a_case_fails(tmp_path, monkeypatch) -> None:
    good = [made for made in stability.cases() if made.family == "logits"][:3]
    bad = replace(good[0], name="a bad one", measure=lambda: need(False, "the reason"))
    for chosen, code in ((good, 0), ([*good, bad], 1)):
        monkeypatch.setattr(stability, "cases", lambda _, chosen=chosen: chosen)
        done = CliRunner().invoke(app, ["accuracy", "stability", "--quick", "--out", str(tmp_path), "--json"])
        assert done.exit_code == code
        found = json.loads((tmp_path / "stability.json").read_text())
        assert json.loads(done.stdout) == found
        assert sum(row["outcome"] == "failed" for row in found["cases"]) == code
        assert ("a bad one: the reason" in done.stderr) == bool(code)
        assert ("**failed**" in (tmp_path / "stability.md").read_text()) == bool(code)


def test_the_committed_report_has_every_case_and_none_failed() -> None:
    text = (COMMITTED / "stability.json").read_text("utf-8")
    found = Report.model_validate_json(text)
    wanted = [(made.family, made.name, made.stiff, made.must, made.outcome) for made in stability.cases()]
    assert [(row.family, row.name, row.stiff, row.must, row.outcome) for row in found.cases] == wanted
    assert (COMMITTED / "stability.md").read_text("utf-8") == markdown(found)
