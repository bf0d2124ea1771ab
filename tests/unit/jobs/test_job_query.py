from datetime import UTC, datetime

import pytest

from scene_attack.errors import InvalidRequest
from scene_attack_service.jobs.job_list import Term, parse_query


def test_a_query_is_a_list_of_terms() -> None:
    assert parse_query('  scene:piano renderer:torch verified p<5e-3 -tag:old "grand piano" ') == (
        Term("scene", "=", ("piano",)),
        Term("renderer", "=", ("torch",)),
        Term("verified", "=", ()),
        Term("p", "<", (0.005,)),
        Term("tag", "=", ("old",), wanted=False),
        Term("", "=", ("grand piano",)),
    )
    assert parse_query("") == ()


@pytest.mark.parametrize(
    ("text", "term"),
    [
        ("state:failed,rejected", Term("state", "=", ("failed", "rejected"))),
        ('scene:"a, b",c', Term("scene", "=", ("a, b", "c"))),
        ("queries>=1000", Term("queries", ">=", (1000.0,))),
        ("seconds:2", Term("seconds", "=", (2.0,))),
        ("created>2026-11-01", Term("created", ">", (datetime(2026, 11, 1, tzinfo=UTC),))),
        ("ended<2026-11-01T02:00+02:00", Term("ended", "<", (datetime(2026, 11, 1, tzinfo=UTC),))),
        ("grand-piano", Term("", "=", ("grand-piano",))),
        ("-verified", Term("verified", "=", (), wanted=False)),
        ("sha256:ab", Term("", "=", ("sha256:ab",))),
    ],
)
def test_terms(text: str, term: Term) -> None:
    assert parse_query(text) == (term,)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("scene:piano rendrer:torch", "at character 13: there is no field 'rendrer';.*did you mean 'renderer'"),
        ("p<small", "at character 3: 'small' is no number; write 5e-3"),
        ("p<nan", "at character 3: 'nan' is no number"),
        ("verified state:faild", "at character 16: there is no state 'faild';.*did you mean 'failed'"),
        ('scene:"grand piano', "at character 7: this quotation mark has no second one"),
        ("state:", "at character 7: state: needs a value"),
        ("tag:a,,b", "at character 5: tag needs a value before and after each comma"),
        ("tag>a", "at character 4: tag is a text: write tag:a"),
        ("verified:yes", "at character 1: verified stands alone"),
        ("ended<soon", "at character 7: 'soon' is no time; write 2026-11-23"),
        ("scene:a -", "at character 9: after a minus there has to be a condition"),
        ("a" * 8001, "at most 4,000 characters"),
        ("tag:a\0", "at character 6: this is the character U\\+0000"),
        ("a " * 51, "at character 101: a query has at most 50 conditions"),
        ("noted id:" + "a," * 250 + "a", "at character 7: a query has at most 250 values"),
    ],
)
def test_what_cannot_be_read_is_said_with_its_place(text: str, said: str) -> None:
    with pytest.raises(InvalidRequest, match=said) as error:
        parse_query(text)
    assert error.value.field == "q"


def test_the_ids_of_a_hundred_jobs_are_a_query() -> None:
    [term] = parse_query("id:" + ",".join([f"{number:032x}" for number in range(100)]))
    assert len(term.values) == 100
