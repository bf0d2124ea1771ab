"""The batched engine against a recursion over each program that knows nothing of levels, stacks and batches."""

from random import Random

import pytest
import torch
from torch import Tensor, nn

from scene_attack_questions.iep.assembly import COMPARING, JOINING, MAPPING, READING, Question, assemble
from scene_attack_questions.iep.engine import N_CELLS, Engine
from scene_attack_questions.program import Program
from tests.unit.questions.iep import seeded, world

pytestmark = pytest.mark.slow

ROUNDING = 1e-5
"""Largest difference as a part of the largest score; float32 rounds each of some ten sums in turn by 1e-7."""


def an_engine(cells: int = 64, dtype: torch.dtype = torch.float64) -> Engine:
    torch.manual_seed(3)
    made = Engine(cells)
    for parameter in made.parameters():  # biases too, so that none can be forgotten
        nn.init.normal_(parameter, std=0.3) if parameter.shape[-1] == 1 else None
    return made.to(dtype).eval()


def some_features(images: int, dtype: torch.dtype = torch.float64) -> Tensor:
    return torch.randn(images, 96, 15, 20, generator=torch.Generator().manual_seed(5)).to(dtype)


def some_programs(count: int) -> list[Program]:
    random = Random(1)
    things = world.scene(random)
    return [world.question(random, things, world.FAMILIES[number % 8])[0] for number in range(count)]


class Reference:
    """One program on the features of one image, node by node."""

    def __init__(self, engine: Engine, features: Tensor, program: Program):
        self.engine, self.program = engine, program
        stem = engine.stem
        looks = (stem.looks.weight[:, :, 0] @ features.flatten(1) + stem.looks.bias[:, None]).relu()
        scene = stem.mask.weight[0, :, 0] @ features.flatten(1) + stem.mask.bias
        x = (torch.arange(N_CELLS) % 20 - 9.5) / 10
        y = (torch.arange(N_CELLS) // 20 - 7.0) / 10
        self.seen = torch.cat([looks, torch.stack([x, y]).to(looks.dtype)])
        ranked = sorted(range(N_CELLS), key=lambda cell: -float(scene[cell]))
        kept = ranked[: stem.cells]
        self.gate = torch.zeros_like(scene)
        self.gate[kept] = (scene[kept] - scene[ranked[stem.cells]]).tanh() if stem.cells < N_CELLS else 1.0
        self.scene = scene

    def mask(self, logits: Tensor) -> Tensor:
        return logits.sigmoid() * self.gate

    def focus(self, logits: Tensor) -> Tensor:
        weight = (logits - logits.max()).exp() * self.gate
        return weight / weight.sum()

    def first(self, layer: nn.Module, place: int, inputs: list[Tensor]) -> Tensor:
        total = layer.image[place] @ self.seen[:64] + layer.absolute[place] @ self.seen[64:] + layer.bias[place]
        for number, logits in enumerate(inputs):
            attended = self.seen @ self.focus(logits)
            relative = self.seen[64:] - attended[64:, None]
            total = total + layer.masks[place][:, 2 * number : 2 * number + 1] * self.mask(logits)
            total = total + layer.masks[place][:, 2 * number + 1 : 2 * number + 2] * logits / 8
            features = layer.scaled[place][:, 64 * number : 64 * number + 64] @ (self.seen[:64] * attended[:64, None])
            total = (
                total + features + (layer.attended[place][:, 64 * number : 64 * number + 64] @ attended[:64])[:, None]
            )
            total = total + layer.relative[place][:, 2 * number : 2 * number + 2] @ relative
        return total.relu()

    def result(self, place: int) -> Tensor:
        """Mask logits [300] of a map, or a vector [64]."""
        node = self.program.nodes[place]
        inputs = [self.result(one) for one in node.inputs]
        name = f"{node.function}[{node.values[0]}]" if node.values else node.function
        if name == "scene":
            return self.scene
        if name == "unique":
            return inputs[0]
        for modules, names in ((self.engine.mapping, MAPPING), (self.engine.joining, JOINING)):
            if name in names:
                at = names.index(name)
                x = self.first(modules.first, at, inputs)
                y = (modules.second[at] @ x + modules.second_bias[at]).relu()
                x = (x + modules.third[at] @ y + modules.third_bias[at]).relu()
                return (modules.mask[at] @ x + modules.mask_bias[at])[0]
        if name in READING:
            reading, at = self.engine.reading, READING.index(name)
            x = self.first(reading.first, at, inputs)
            pooled = torch.cat([x @ self.mask(inputs[0]), x @ self.focus(inputs[0])])
            return (reading.second[at] @ pooled + reading.second_bias[at][:, 0]).relu()
        comparing, at = self.engine.comparing, COMPARING.index(name)
        one, other = (self.engine.classifier(vector).softmax(0) for vector in inputs)
        x = torch.cat([*inputs, one, other, one * other])
        x = (comparing.first[at] @ x + comparing.first_bias[at][:, 0]).relu()
        return (comparing.second[at] @ x + comparing.second_bias[at][:, 0]).relu()

    def scores(self) -> Tensor:
        result: Tensor = self.engine.classifier(self.result(len(self.program.nodes) - 1))
        return result


@pytest.mark.parametrize(("cells", "images"), [(64, 3), (N_CELLS, 1)])
@torch.no_grad()
def test_scores_and_attention_are_those_of_a_recursion_over_each_program(cells: int, images: int) -> None:
    engine, features = an_engine(cells), some_features(images)
    programs = some_programs(24)
    execution = engine(features, assemble([Question(program, k % images) for k, program in enumerate(programs)]))
    assert {node.function for program in programs for node in program.nodes} >= {"union", "relate", "less_than"}
    for number, program in enumerate(programs):
        reference = Reference(engine, features[number % images], program)
        assert torch.allclose(execution.scores[number], reference.scores(), atol=1e-10)
        for place, kind in enumerate(program.types):
            if kind in ("set", "object"):
                expected = reference.mask(reference.result(place)).view(15, 20)
                assert torch.allclose(execution.attention(number, place), expected, atol=1e-10)


@torch.no_grad()
def test_scores_do_not_depend_on_the_other_questions_and_images() -> None:
    engine, features, programs = an_engine(dtype=torch.float32), some_features(4, torch.float32), some_programs(32)
    together = engine(features, assemble([Question(program, k % 4) for k, program in enumerate(programs)])).scores
    for number, program in enumerate(programs):
        image = features[number % 4 : number % 4 + 1]
        alone = engine(image, assemble([Question(program)])).scores[0]
        assert (together[number] - alone).abs().max() < ROUNDING * together[number].abs().max()


def test_the_gradient_is_that_of_finite_differences() -> None:
    engine, features = an_engine(), some_features(2).requires_grad_(True)
    assembly = assemble([Question(program, k % 2) for k, program in enumerate(some_programs(8))])
    weights = torch.randn(8, 28, generator=torch.Generator().manual_seed(2)).double()
    (gradient,) = torch.autograd.grad((engine(features, assembly).scores * weights).sum(), features)
    direction = torch.randn(features.shape, generator=torch.Generator().manual_seed(9)).double()
    step = 1e-8
    with torch.no_grad():
        above, below = (
            (engine(features + sign * step * direction, assembly).scores * weights).sum() for sign in (1, -1)
        )
    slope = float((above - below) / (2 * step))
    assert float((gradient * direction).sum()) == pytest.approx(slope, rel=1e-5)


def test_gradients_reach_the_modules_that_are_used_and_no_other() -> None:
    engine, features = an_engine(), some_features(1)
    used = ("filter_color[red]", "relate[left]", "union", "count", "query_shape", "equal_shape")
    queries = ("scene", "filter_color 0 red", "unique 1", "relate 2 left", "union 1 3", "unique 4", "query_shape 5")
    programs = (seeded.program(*queries, "query_shape 2", "equal_shape 6 7"), seeded.program("scene", "count 0"))
    engine(features, assemble([Question(program) for program in programs])).scores.square().sum().backward()
    for modules, names in (
        (engine.mapping, MAPPING),
        (engine.joining, JOINING),
        (engine.reading, READING),
        (engine.comparing, COMPARING),
    ):
        reached = torch.stack([parameter.grad.flatten(1).abs().sum(1) for parameter in modules.parameters()])
        for place, name in enumerate(names):
            assert (reached[:, place] > 0).all() if name in used else (reached[:, place] == 0).all(), name


@torch.no_grad()
def test_scores_are_continuous_where_a_cell_drops_out() -> None:
    engine, features = an_engine(), some_features(2)
    assembly = assemble([Question(program) for program in some_programs(8)])

    def cells(part: float) -> set[int]:
        return set(engine.stem(at(part)).cells[0].tolist())

    def at(part: float) -> Tensor:
        return torch.lerp(features[:1], features[1:], part)

    low, high = 0.0, 1.0
    assert cells(low) != cells(high)
    while high - low > 1e-13:
        middle = (low + high) / 2
        low, high = (low, middle) if cells(low) != cells(middle) else (middle, high)
    assert cells(low) != cells(high)
    assert (engine(at(low), assembly).scores - engine(at(high), assembly).scores).abs().max() < 1e-9


@torch.no_grad()
def test_what_has_no_mask_has_no_attention() -> None:
    execution = an_engine()(some_features(1), assemble([Question(seeded.program("scene", "count 0"))]))
    assert execution.attention(0, 0).shape == (15, 20)
    with pytest.raises(ValueError, match="count"):
        execution.attention(0, 1)


def test_features_of_another_shape_or_of_too_few_images_are_refused() -> None:
    engine, program = an_engine(), some_programs(1)[0]
    with pytest.raises(ValueError, match="2 images"):
        engine(some_features(1), assemble([Question(program, 1)]))
    with pytest.raises(ValueError, match="features"):
        engine(some_features(1)[:, :, :14], assemble([Question(program)]))
