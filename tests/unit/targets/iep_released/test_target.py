"""The converted network against a plain evaluation of the published weights, a question and an image at a time."""

from pathlib import Path
from random import Random

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from services.errors import InvalidRequest
from services.questions.answers import ANSWERS, kind_asked
from services.questions.program import InvalidProgram, Program
from services.questions.text import UnknownWord
from services.questions.written import written
from services.targets import registry
from services.targets.iep.prefix import to_prefix
from services.targets.iep.vocabulary import MAPPED
from services.targets.iep_released.checkpoint import load
from services.targets.iep_released.target import ReleasedIepTarget
from services.targets.iep_released.trunk import Trunk
from services.targets.preprocessing import Preprocessing
from tests.unit.targets.iep import world
from tests.unit.targets.iep_released import published, reference
from tests.unit.targets.iep_released.conftest import Published

EQUAL = ("equal_color", "equal_material", "equal_shape", "equal_size")
ROUNDING = 1e-10
"""Largest difference of scores in double precision, as a part of the largest score."""

HOW = Preprocessing(mean=(0.485, 0.456, 0.406), scale=(0.229, 0.224, 0.224), resize="bicubic")
"""How images were prepared: ImageNet's statistics, but for the scale of blue, which is that of green."""


def images(count: int, height: int = 224, width: int = 224) -> Tensor:
    return torch.rand(count, height, width, 3, generator=torch.Generator().manual_seed(5)).double()


def programs(count: int) -> list[Program]:
    random = Random(1)
    things = world.scene(random)
    return [world.question(random, things, world.FAMILIES[number % 8])[0] for number in range(count)]


@pytest.fixture
def in_double(root: Path) -> ReleasedIepTarget:
    return ReleasedIepTarget("double", load(root / "released" / "model.safetensors"), HOW, "0" * 64, torch.float64)


def true_scores(made: Published, image: Tensor, program: Program) -> Tensor:
    state = reference.double(made.engine["execution_engine_state"])
    found = reference.features(reference.double(made.trunk), image)
    all_scores = reference.scores(state, reference.outputs(state, found, program)[-1])
    numbers = published.vocab()["answer_token_to_idx"]
    return torch.stack([all_scores[numbers[answer]] for answer in ANSWERS])


@torch.no_grad()
def test_scores_are_those_of_the_published_weights(in_double: ReleasedIepTarget, made: Published) -> None:
    shown, asked = images(2), programs(24)
    functions = {node.function for program in asked for node in program.nodes}
    assert len(functions & {"union", "intersect", "equal_integer", "less_than", "greater_than", *EQUAL}) > 2
    found = in_double.answers(shown, [written(program) for program in asked])
    for image, of_image in zip(shown, found, strict=True):
        for program, scores in zip(asked, of_image, strict=True):
            true = true_scores(made, image, program)
            assert (scores - true).abs().max() < ROUNDING * true.abs().max()
    assert found.std(dim=0).max() > 1e-3  # images differ
    assert torch.equal(in_double.logits(shown, written(asked[3])), in_double.answers(shown, [written(asked[3])])[:, 0])


@pytest.mark.usefixtures("target")
def test_it_is_listed_and_passes_the_trial_of_every_target(target: ReleasedIepTarget, made: Published) -> None:
    card = registry.card("released")
    assert card.takes_question
    assert card.vocabulary == "clevr"
    assert registry.labels("released") == target.labels == ANSWERS
    assert registry.has_gradient("released")
    shown, asked = images(1), programs(1)[0]
    true = true_scores(made, shown[0], asked)
    assert (target.logits(shown.float(), written(asked))[0] - true).abs().max() < 1e-5 * true.abs().max()


def test_a_question_in_words_has_the_program_that_was_taught(target: ReleasedIepTarget) -> None:
    for question, program in published.QUESTIONS.items():
        assert tuple(to_prefix(target.program(question))) == program
    assert kind_asked(target.program("how MANY Cubes  are there")) == "integer"
    with pytest.raises(UnknownWord, match="word 3, 'mauve'"):
        target.program("How many mauve cubes are there?")
    with pytest.raises(UnknownWord, match="'<UNK>'"):
        target.program("<UNK>")
    with pytest.raises(InvalidRequest, match="needs 1 to"):
        target.program("?")
    with pytest.raises(InvalidProgram):
        target.program('[{"function":"scene"}]')
    with pytest.raises(ValueError, match="needs a question"):
        target.logits(images(1).float())


def test_the_generator_writes_the_likeliest_tokens(made: Published, tmp_path: Path) -> None:
    untaught = published.generator(taught=False)
    torch.save(untaught, tmp_path / "untaught.pt")
    folder = made.converted(tmp_path / "out", generator=tmp_path / "untaught.pt")
    network = load(folder / "model.safetensors")
    seen = set()
    for question in ([1, 5, 2], [1, 6, 7, 8, 9, 2], [1, 10, 2], [1, 4, 4, 11, 2]):
        found = network.generator.write(question, 1, [3] * 44)  # such a program never ends
        assert found == reference.written(untaught["program_generator_state"], question, len(found))
        seen |= {tuple(found)}
        assert network.generator.write(question, 1, [0] * 44) == found[:1]
        assert network.generator.write(question, 1, [None] * 44) == []
    assert len(found) == 64
    assert len(seen) > 1
    with pytest.raises(InvalidRequest, match="no program can be made"):
        ReleasedIepTarget("untaught", network, HOW, "0" * 64).program("How many cubes are there?")


def test_images_are_resized_as_the_published_scripts_do_but_not_rounded(root: Path) -> None:
    picture = Image.fromarray((255 * images(1, 30, 40)[0]).byte().numpy()).resize((480, 320), Image.Resampling.BILINEAR)
    resized = np.asarray(picture.resize((224, 224), Image.Resampling.BICUBIC), np.float64) / 255
    mean, std = torch.tensor(reference.MEAN), torch.tensor(reference.STD)
    wanted = ((torch.from_numpy(resized) - mean) / std).permute(2, 0, 1)[None]
    inputs: list[Tensor] = []
    network = load(root / "released" / "model.safetensors")
    network.trunk.register_forward_pre_hook(lambda _, taken: inputs.append(taken[0]))
    target = ReleasedIepTarget("double", network, HOW, "0" * 64, torch.float64)
    with torch.no_grad():
        target.logits(torch.from_numpy(np.asarray(picture) / 255)[None], written(programs(1)[0]))
    levels = (inputs[0] - wanted).abs() * std[:, None, None] * 255
    # Theirs is rounded to 8 bits after the rows and after the columns, whose weights' absolute values sum to 1.4.
    assert 0.1 < levels.max() < 0.5 + 0.5 * 1.4
    assert levels.mean() < 0.5


def test_the_gradient_is_that_of_finite_differences(in_double: ReleasedIepTarget) -> None:
    image, question = images(1, 60, 80).requires_grad_(), written(programs(4)[3])
    (gradient,) = torch.autograd.grad(in_double.logits(image, question)[0, 4], image)
    assert gradient.abs().max() > 0
    direction = torch.randn(image.shape, generator=torch.Generator().manual_seed(8)).double()
    step = 1e-7
    with torch.no_grad():
        above, below = (in_double.logits(image + sign * step * direction, question)[0, 4] for sign in (1, -1))
    assert float((gradient * direction).sum()) == pytest.approx(float((above - below) / (2 * step)), rel=1e-4)


def test_attention_is_the_gradient_of_the_scores_at_each_set(in_double: ReleasedIepTarget, made: Published) -> None:
    shown, program = images(2), programs(8)[7]
    state, numbers = reference.double(made.engine["execution_engine_state"]), published.vocab()["answer_token_to_idx"]
    found = in_double.attention(shown, written(program))
    assert [one is not None for one in found] == [kind in MAPPED for kind in program.types]
    assert not all(one is None for one in found)
    for image in range(2):
        seen = reference.features(reference.double(made.trunk), shown[image]).requires_grad_()
        outputs = reference.outputs(state, seen, program)
        scores = reference.scores(state, outputs[-1])
        total = scores[[numbers[answer] for answer in ANSWERS]].sum()
        gradients = torch.autograd.grad(total, outputs)
        for place, mask in enumerate(found):
            if mask is not None:
                same = [g for g, output in zip(gradients, outputs, strict=True) if torch.equal(output, outputs[place])]
                norm = torch.stack(same).sum(0).pow(2).sum(0).sqrt()  # equal parts of a program are one
                assert torch.allclose(mask[image].double(), norm / norm.max(), atol=1e-6)
                assert mask.shape == (2, 14, 14)


def test_the_trunk_is_resnet_101_up_to_its_third_stage() -> None:
    with torch.device("meta"):
        trunk = Trunk(64, (3, 4, 23))
        assert trunk(torch.empty(1, 3, 224, 224)).shape == (1, 1024, 14, 14)
    # 44,549,160 parameters of torchvision's, without 14,964,736 of its last stage and 2,049,000 of its classifier
    assert sum(parameter.numel() for parameter in trunk.parameters()) == 27_535_424
