"""Every case holds, and every case fails when what it looks at is broken."""

import pytest

from services.accuracy.stability.case import Case, observe
from services.accuracy.stability.report import cases
from tests.unit.accuracy.mutants import MUTANTS
from tests.unit.accuracy.sabotage import BROKEN

pytestmark = pytest.mark.slow

ALL = {(case.family, case.name): case for case in cases()}
QUICK = cases(quick=True)

ROWS = [
    *((family, name, how) for family, rows in BROKEN.items() for how, names in rows for name in names),
    *((family, name, how) for how, seen in MUTANTS for family, names in seen.items() for name in names),
]
SABOTAGE = [(ALL[family, name], how) for family, name, how in ROWS]


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
    assert observe(case).outcome == "failed"


def test_every_case_has_been_broken() -> None:
    assert [case for case, _ in SABOTAGE if ALL[case.family, case.name] is not case] == []
    assert {(case.family, case.name) for case, _ in SABOTAGE} == ALL.keys()
    assert len(ALL) == len(cases()), "two cases have the same name"
