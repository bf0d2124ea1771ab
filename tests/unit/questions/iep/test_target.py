from pathlib import Path

import pytest
import torch
from torch.nn import functional as F

from scene_attack.errors import InvalidRequest
from scene_attack.targets import registry
from scene_attack_questions.executor import ANSWERS
from scene_attack_questions.iep.assembly import Question, assemble
from scene_attack_questions.iep.card import CARD
from scene_attack_questions.iep.checkpoint import Checkpoint, load, to_bytes
from scene_attack_questions.iep.program_generator import TOKENS, ProgramGenerator
from scene_attack_questions.iep.target import IepTarget, read
from scene_attack_questions.program import InvalidProgram, program_in, written
from scene_attack_questions.text import UnknownWord
from tests.unit.questions.iep.seeded import COUNT, INFO, SAME, TAUGHT, generator, network, program, target

pytestmark = pytest.mark.slow


def images(count: int, height: int = 240, width: int = 320) -> torch.Tensor:
    return torch.rand(count, height, width, 3, generator=torch.Generator().manual_seed(5))


def test_it_passes_the_trial_of_every_target() -> None:
    with registry.registered(INFO, target()):
        found = registry.load(INFO.name)
        assert found.labels == registry.labels(INFO.name) == ANSWERS
        assert registry.has_gradient(INFO.name)


@torch.no_grad()
def test_a_question_in_words_has_the_scores_of_its_program() -> None:
    shown = images(2)
    for question, known in TAUGHT.items():
        expected = network()(shown, assemble([Question(known, 0), Question(known, 1)])).scores
        assert torch.equal(target().asked(question).logits(shown), expected)
        assert torch.equal(target().asked(written(known)).logits(shown), expected)


@torch.no_grad()
def test_images_of_other_sizes_are_resized() -> None:
    large = images(1, 448, 448)
    small = F.interpolate(large.permute(0, 3, 1, 2), (240, 320), mode="bilinear", antialias=True).permute(0, 2, 3, 1)
    assert torch.equal(target().asked(written(SAME)).logits(large), target().asked(written(SAME)).logits(small))


def test_attention_is_that_of_each_module() -> None:
    shown = images(2)
    found = target().attention(shown, written(SAME))
    with torch.no_grad():
        execution = network()(shown, assemble([Question(SAME, 0), Question(SAME, 1)]))
    assert [one is not None for one in found] == [True, True, True, True, True, False]
    for node, mask in enumerate(found[:-1]):
        assert mask is not None
        assert mask.shape == (2, 15, 20)
        for image in range(2):
            assert torch.equal(mask[image], execution.attention(image, node))


def test_a_program_is_a_text_and_comes_back() -> None:
    assert program_in(written(SAME)) == SAME
    assert program_in("How many things are there?") is None
    with pytest.raises(InvalidRequest, match="begins as the JSON"):
        program_in("[{")
    with pytest.raises(InvalidProgram) as refused:
        program_in(written(program("scene", "filter_color 0 red", "query_size 1")))
    assert (refused.value.node, refused.value.reason) == (2, "type")


def test_what_cannot_be_asked_is_said() -> None:
    with pytest.raises(UnknownWord, match="'mauve'"):
        target().asked("How many mauve things are there?").logits(images(1))
    ignorant = ProgramGenerator().requires_grad_(False)
    ignorant.output.weight.zero_()  # the bias alone says which function comes, whatever was read
    ignorant.output.bias.zero_()[TOKENS.index("scene")] = 1.0
    with pytest.raises(InvalidRequest, match="no program can be made"):
        IepTarget("ignorant", Checkpoint(network(), ignorant), "0" * 64).program("How many things are there?")
    with pytest.raises(ValueError, match="needs a question"):
        target().logits(images(1))


def test_missing_or_damaged_weights_are_said(tmp_path: Path) -> None:
    path = tmp_path / "iep.safetensors"
    with pytest.raises(InvalidRequest, match=r"iep\.safetensors, are not there; .*train them"):
        read("iep", path, torch.float32)
    path.write_bytes(b"weights")
    with pytest.raises(InvalidRequest, match="cannot be used"):
        read("iep", path, torch.float32)
    path.write_bytes(to_bytes(network(), generator()))
    shown = images(1)
    found = read("iep", path, torch.float32)
    stored = IepTarget(INFO.name, load(path), "0" * 64)  # 8 bits per weight
    assert torch.equal(found.asked(written(COUNT)).logits(shown), stored.asked(written(COUNT)).logits(shown))


def test_it_is_listed_with_its_answers() -> None:
    assert registry.card("iep") == CARD
    assert registry.labels("iep") == ANSWERS
