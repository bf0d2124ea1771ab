"""Generated questions: the same for the same seed, different from each other, and balanced."""

from collections import Counter, defaultdict

from scene_attack_questions.clevr.generator import generate
from scene_attack_questions.families import FAMILIES
from scene_attack_questions.generator import QuestionGenerator

SCENES = [generate(21, k) for k in range(30)]


def test_questions_depend_on_seed_and_scenes_alone() -> None:
    first, second, other = QuestionGenerator(1), QuestionGenerator(1), QuestionGenerator(2)
    made = [first.ask(scene, 6) for scene in SCENES]
    assert [second.ask(scene, 6) for scene in SCENES] == made
    assert [other.ask(scene, 6) for scene in SCENES] != made


def test_a_scene_has_different_questions_with_their_own_numbers() -> None:
    generator = QuestionGenerator(0, FAMILIES[:6])
    questions = [question for scene in SCENES for question in generator.ask(scene, 20)]
    assert [question.question_index for question in questions] == list(range(len(questions)))
    for scene in SCENES:
        of_scene = [question for question in questions if question.image_index == scene.image_index]
        assert len({question.program for question in of_scene}) == len(of_scene)
        assert {question.image_filename for question in of_scene} == {scene.image_filename}
        # More than there are families, unless a scene has fewer questions.
        assert len(of_scene) == 20 or len(scene.objects) <= 5


def test_only_the_given_families_are_asked() -> None:
    some = [family for family in FAMILIES if family.kind in ("one_hop", "comparison")]
    generator = QuestionGenerator(0, some)
    asked = {FAMILIES[q.question_family_index] for scene in SCENES for q in generator.ask(scene, 8)}
    assert asked == set(some)


def test_questions_are_balanced(asked) -> None:
    kinds, functions, answers = Counter(), defaultdict(Counter), defaultdict(Counter)
    values: defaultdict[str, Counter] = defaultdict(Counter)
    for _, questions in asked:
        for question in questions:
            family = FAMILIES[question.question_family_index]
            kinds[family.kind] += 1
            functions[family.kind][family.asks] += 1
            answers[family.asks][question.answer] += 1
            for node in question.program.nodes:
                values[node.function].update(node.values)
    assert len(kinds) == 9
    assert even(kinds, 1.05)
    assert all(even(of_kind, 1.05) for of_kind in functions.values())
    for asks, of_function in answers.items():
        if asks == "count":
            # Sets of two are frequent in unions, and few scenes have ten objects.
            assert max(of_function.values()) < 0.35 * of_function.total()
            assert len(of_function) == 11
        else:
            assert even(of_function, 1.5 if asks == "equal_color" else 1.15), (asks, of_function)
    for name, of_values in values.items():
        assert not of_values or even(of_values, 1.35), (name, of_values)


def even(counts: Counter, ratio: float) -> bool:
    return max(counts.values()) <= ratio * min(counts.values()) + 3
