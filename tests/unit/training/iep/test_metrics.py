import pytest

from services.attacks.outcome import wilson
from services.questions.program import Node, Program
from training.iep.checking import by_family
from training.iep.examples import Example

COUNT = Program((Node("scene", (), ()), Node("filter_size", (0,), ("small",)), Node("count", (1,), ())))
EXIST = Program((Node("scene", (), ()), Node("exist", (0,), ())))


def test_shares_are_counted_by_family() -> None:
    examples = [
        Example(0, "", program, (), family)
        for program, family in ((COUNT, "count"), (COUNT, "count"), (COUNT, "count"), (EXIST, "exist"))
    ]
    families = by_family(examples, [True, False, True, False])
    assert {name: (one.right, one.of) for name, one in families.items()} == {
        "overall": (2, 4),
        "count": (2, 3),
        "exist": (0, 1),
    }
    assert families["count"].share == pytest.approx(2 / 3)
    assert families["count"].interval == wilson(2, 3)
