from scene_attack_questions.clevr.generator import generate
from scene_attack_questions.executor import Facts
from scene_attack_questions.generator import QuestionGenerator
from training.iep.examples import Example, ObjectTruth


def test_examples_of_generated_questions_have_the_result_of_every_node() -> None:
    asking = QuestionGenerator(1)
    seen = set()
    for index in range(3):
        scene = generate(3, index)
        facts = Facts.of(scene)
        for question in asking.ask(scene, 20):
            example = Example.of(index, question, facts)
            assert example.answer == question.answer
            assert example.text == question.question
            for node, result in zip(example.program.nodes, example.results, strict=True):
                taken = [example.results[one] for one in node.inputs]
                seen.add(node.function)
                if node.function == "scene":
                    assert result == tuple(range(len(scene.objects)))
                elif node.function.startswith("filter_"):
                    name = node.function.removeprefix("filter_")
                    assert result == tuple(k for k in taken[0] if scene.objects[int(k)].value(name) == node.values[0])
                elif node.function == "unique":
                    assert result == taken[0]
                elif node.function == "count":
                    assert result == str(len(taken[0]))
                elif node.function == "exist":
                    assert result == ("yes" if taken[0] else "no")
    assert {"unique", "count", "exist", "relate", "query_color"} <= seen


def test_the_cell_of_an_object_is_that_of_its_pixel() -> None:
    record = generate(3, 0).objects[0]
    truth = ObjectTruth.of(record)
    column, row, _ = record.pixel_coords
    assert truth.cell == (row // 16) * 20 + column // 16
    assert truth.attributes["color"] == record.color
