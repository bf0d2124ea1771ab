from scene_attack.runs.target_check import check
from scene_attack.targets import registry
from scene_attack_questions.executor import ANSWERS
from tests.unit.jobs.small import LIBRARY
from tests.unit.questions.iep.seeded import INFO, target


def test_a_network_for_questions_is_asked_that_of_its_card_about_a_generated_scene() -> None:
    with registry.registered(INFO, target()):
        found = check(INFO.name, "primitive/cube", LIBRARY)
    assert (found.mesh, found.asked) == (None, INFO.example)
    assert found.gradient
    assert all(answer.label in ANSWERS for answer in found.answers)
    assert found.seconds.keys() == {1, 8}
