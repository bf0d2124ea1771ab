import pytest
import torch

from scene_attack.errors import InvalidRequest
from scene_attack_questions.iep.program_generator import TOKENS, ProgramGenerator
from scene_attack_questions.program import InvalidProgram, Program
from scene_attack_questions.text import UnknownWord, encoded

QUESTIONS = ("How many cubes are there?", "red?", "Are there any other red things that are big?")


@pytest.fixture(scope="module")
def generator() -> ProgramGenerator:
    torch.manual_seed(1)
    return ProgramGenerator().eval()


@torch.no_grad()
def test_scores_do_not_depend_on_the_other_questions_of_a_batch(generator: ProgramGenerator) -> None:
    questions = [encoded(question) for question in QUESTIONS]
    tokens = torch.randint(len(TOKENS), (3, 7), generator=torch.Generator().manual_seed(2))
    together = generator(questions, tokens)
    assert together.shape == (3, 7, len(TOKENS))
    for number, question in enumerate(questions):
        assert torch.allclose(together[number], generator([question], tokens[number : number + 1])[0], atol=1e-6)


@torch.no_grad()
def test_scores_of_a_token_depend_on_those_before_it_only(generator: ProgramGenerator) -> None:
    questions = [encoded(QUESTIONS[0])]
    tokens = torch.zeros(1, 6, dtype=torch.int64)
    changed = tokens.clone()
    changed[0, 3] = 5
    before, after = generator(questions, tokens)[0], generator(questions, changed)[0]
    assert torch.equal(before[:4], after[:4])
    assert not torch.allclose(before[4], after[4])


def test_what_is_written_ends_with_the_program_or_is_too_long() -> None:
    made = ProgramGenerator().eval()
    torch.nn.init.zeros_(made.output.weight)  # the bias alone says which token comes, whatever was read
    torch.nn.init.zeros_(made.output.bias)
    for token, reason in (("scene", "root"), ("count", "form"), ("union", "form")):
        with torch.no_grad():
            made.output.bias[TOKENS.index(token)] = float(made.output.bias.max()) + 1
        (found,) = made.generate([QUESTIONS[0]])
        assert isinstance(found, InvalidProgram)
        assert found.reason == reason


def test_an_untrained_generator_gives_programs_or_typed_errors() -> None:
    for seed in range(20):
        torch.manual_seed(seed)
        for found in ProgramGenerator().eval().generate(QUESTIONS):
            assert isinstance(found, Program | InvalidRequest)


def test_words_outside_the_language_are_named_and_the_other_questions_answered(generator: ProgramGenerator) -> None:
    first, second, third = generator.generate(["How many cuebs are mauve?", QUESTIONS[1], ""])
    assert isinstance(first, UnknownWord)
    assert first.word == "cuebs"
    assert isinstance(second, Program | InvalidProgram)
    assert isinstance(third, InvalidRequest)
