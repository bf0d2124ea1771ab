"""Every case holds, and every case fails when what it looks at is broken."""

import re

import pytest

from scene_attack_accuracy.stability.case import Case, observe
from scene_attack_accuracy.stability.report import cases
from tests.unit.accuracy.mutants import MUTANTS

pytestmark = pytest.mark.slow

ALL = {(case.family, case.name): case for case in cases()}
QUICK = cases(quick=True)

SABOTAGE = [(ALL[family, name], how) for how, family, names in MUTANTS for name in names.split("; ")]


def named(case: Case) -> str:
    return f"{case.family}: {case.name}"


@pytest.mark.parametrize("case", QUICK, ids=named)
def test_holds(case: Case) -> None:
    seen = observe(case)
    assert seen.outcome == case.outcome, seen.what


@pytest.mark.parametrize(
    ("case", "how"),
    [row for row in SABOTAGE if not row[0].slow],
    ids=lambda value: getattr(value, "name", getattr(value, "__name__", "")),
)
def test_fails_when_the_method_is_broken(case: Case, how, monkeypatch) -> None:
    how(monkeypatch)
    seen = observe(case)
    assert seen.outcome == "failed"
    assert not re.search(r"\b[A-Z]\w*Error\b", seen.what), f"the damage itself does not run: {seen.what}"


def test_every_case_has_been_broken() -> None:
    assert {(case.family, case.name) for case, _ in SABOTAGE} == ALL.keys()
    assert len(ALL) == len(cases()), "two cases have the same name"
