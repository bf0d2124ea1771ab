"""A plan's error: the errors that meet in a part add up, and the worst part counts."""

import pytest

from scene_attack.rendering.plan import Item, Plan, Stage


def item(part: str, error: float) -> Item:
    return Item(part=part, what="lobes", kept=1, of=2, why="small", error=error)


def stage(part: str, error: float) -> Stage:
    return Stage(
        part=part, name="pixels", method="table", when="every image", evaluations=1, unit="lookups", why="", error=error
    )


def test_errors_of_a_part_add_up_and_the_worst_part_counts() -> None:
    items = [item("object 0", 1e-4), item("object 1", 5e-4), item("", 1e-5)]
    stages = [stage("object 0", 3e-4), stage("object 0", 2e-4), stage("object 1", 5e-5), stage("", 2e-5)]
    plan = Plan.of("torch", ("normals",), (4, 5), 1e-3, items, stages)
    assert plan.error == pytest.approx(1e-4 + 3e-4 + 2e-4 + 1e-5 + 2e-5)
    assert Plan.of("torch", (), (4, 5), "exact", [], []).error == 0
