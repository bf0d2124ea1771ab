"""The answers and their kinds."""

import pytest

from services.errors import InvalidRequest
from services.questions.executor import ANSWERS, KINDS, kind_asked, kind_of

pytestmark = pytest.mark.slow


def test_there_are_28_different_answers() -> None:
    assert len(ANSWERS) == len(set(ANSWERS)) == 28
    assert {kind: len(answers) for kind, answers in KINDS.items()} == {
        "boolean": 2, "integer": 11, "shape": 3, "size": 2, "color": 8, "material": 2,
    }  # fmt: skip


def test_a_question_s_answer_is_of_the_kind_its_program_asks_for(asked) -> None:
    for _, questions in asked:
        for question in questions:
            assert kind_of(question.answer) == kind_asked(question.program)


def test_an_unknown_answer_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="did you mean 'purple'"):
        kind_of("purpel")
