import pytest
import torch

from scene_attack_questions.clevr.records import ATTRIBUTES
from scene_attack_questions.iep.engine import Engine
from training.iep.examples import ObjectTruth
from training.iep.trunk_training import ObjectFinder, Truth, hand_over, trunk_accuracy, trunk_loss

RED_CUBE = ObjectTruth(40.0, 100.0, {"size": "large", "color": "red", "material": "metal", "shape": "cube"})
GRAY_BALL = ObjectTruth(239.5, 4.0, {"size": "small", "color": "gray", "material": "rubber", "shape": "sphere"})
CYAN_ROD = ObjectTruth(130.0, 319.0, {"size": "small", "color": "cyan", "material": "metal", "shape": "cylinder"})
TRUTH = Truth.of([[RED_CUBE, GRAY_BALL], [], [CYAN_ROD]])


def perfect() -> torch.Tensor:
    """What a finder without errors finds: scores of ±20."""
    found = torch.zeros(3, 300, 18)
    found[:, :, 0] = -20.0
    names = [(name, value) for name, values in ATTRIBUTES.items() for value in values]
    for image, one in ((0, RED_CUBE), (0, GRAY_BALL), (2, CYAN_ROD)):
        own = [20.0 if one.attributes[name] == value else -20.0 for name, value in names]
        place = [one.row / 16 - one.row // 16 - 0.5, one.column / 16 - one.column // 16 - 0.5]
        found[image, int(one.row // 16) * 20 + int(one.column // 16)] = torch.tensor([20.0, *own, *place])
    return found


def test_cells_are_those_of_centres() -> None:
    assert [one.cell for one in (RED_CUBE, GRAY_BALL, CYAN_ROD)] == [2 * 20 + 6, 14 * 20, 8 * 20 + 19]
    assert ObjectTruth(-3.0, 400.0, {}).cell == 19
    assert TRUTH.centres.nonzero().tolist() == [[0, 46], [0, 280], [2, 179]]
    assert TRUTH.images.tolist() == [0, 0, 2]
    assert TRUTH.places[0].tolist() == [0.0, -0.25]


def test_a_perfect_finder_has_no_loss_and_all_right() -> None:
    loss, parts = trunk_loss(perfect(), TRUTH)
    assert float(loss) < 1e-6
    assert set(parts) == {"heat", "attributes", "place"}
    assert set(trunk_accuracy(perfect(), TRUTH).values()) == {1.0}


@pytest.mark.parametrize("name", list(ATTRIBUTES))
def test_a_wrong_attribute_costs_its_part_alone(name: str) -> None:
    names = [one for one, values in ATTRIBUTES.items() for _ in values]
    found = perfect()
    for column, one in enumerate(names):
        if one == name:
            found[0, 46, 1 + column] *= -1
    accuracy = trunk_accuracy(found, TRUTH)
    assert {one for one, share in accuracy.items() if share < 1} == {name, "all"}
    assert accuracy["all"] == pytest.approx(2 / 3)
    assert trunk_loss(found, TRUTH)[1]["attributes"] > 10


def test_a_centre_that_is_missed_or_misplaced_costs() -> None:
    missed, misplaced = perfect(), perfect()
    missed[0, 280, 0], missed[0, 10, 0] = -20.0, 20.0
    misplaced[0, 46, 16] = 0.5
    assert trunk_accuracy(missed, TRUTH)["found"] == pytest.approx(2 / 3)
    assert trunk_loss(missed, TRUTH)[1]["heat"] == pytest.approx((4 + 1) * 20 / 900, rel=1e-3)
    assert trunk_loss(misplaced, TRUTH)[1]["place"] == pytest.approx((0.5 - 0.05) / 6, rel=1e-3)


def test_the_engine_begins_with_the_centres_that_the_trunk_found() -> None:
    torch.manual_seed(0)
    finder, engine = ObjectFinder().eval(), Engine()
    hand_over(finder, engine)
    images = torch.rand(1, 240, 320, 3)
    with torch.no_grad():
        scores = finder(images)[:, :, 0]
        assert torch.allclose(engine.stem(finder.trunk(images)).scene, scores, atol=1e-5)
