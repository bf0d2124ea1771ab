"""The variants of the engine that the benchmark of departures trains: each differs from the engine in what it says."""

from pathlib import Path

import pytest
import torch
from torch.nn import functional as F

from benchmarks.iep_departures import step_of
from benchmarks.iep_unique import assemble_with_unique
from benchmarks.iep_variants import (
    VARIANTS,
    NeighbourModules,
    answers_alone,
    cells_of,
    neighbours,
    supervised,
    with_module_of_unique,
)
from services.questions.answers import ANSWERS
from services.targets.iep.assembly import assemble
from services.targets.iep.engine import Engine
from services.targets.iep.modules import WIDTH, MapModules, attend
from services.training.iep.loop import Schedule, TrainingLoop
from tests.unit.training.iep.conftest import Data

AS_IT_IS, ANSWERS_ALONE, NO_ATTENTION, NEIGHBOURS, UNIQUE = VARIANTS


def test_the_first_variant_is_the_engine_of_the_project() -> None:
    assert AS_IT_IS.build is Engine
    assert AS_IT_IS.assemble is assemble
    assert AS_IT_IS.loss is supervised


@pytest.mark.usefixtures("one_thread")
def test_every_variant_learns_and_what_is_left_out_stays_out(mixed: Data, tmp_path: Path) -> None:
    for number, variant in enumerate(VARIANTS):
        torch.manual_seed(0)
        engine = variant.build()
        before = [parameter.detach().clone() for parameter in engine.parameters()]
        step = step_of(variant, engine, mixed, batch=8)
        TrainingLoop("engine", engine, Schedule(2, 1e-3), step, 0, tmp_path / str(number)).run(lambda _: None)
        after = zip(engine.named_parameters(), before, strict=True)
        changed = {name for (name, now), then in after if not torch.equal(now, then)}
        assert "stem.looks.weight" in changed
        if variant is NO_ATTENTION:
            assert not any(part in name for name in changed for part in ("scaled", "attended", "relative"))
            for modules in (engine.mapping, engine.joining, engine.reading):
                assert not modules.first.scaled.any()
                assert not modules.first.attended.any()
                assert not modules.first.relative.any()


def test_the_published_loss_is_the_cross_entropy_of_the_answers(mixed: Data) -> None:
    some = mixed.examples[:12]
    torch.manual_seed(0)
    execution = ANSWERS_ALONE.execute(Engine(), mixed.features, some)
    right = torch.tensor([ANSWERS.index(example.answer) for example in some])
    cells = [mixed.cells[example.image] for example in some]
    found = answers_alone(execution, some, cells)
    assert torch.allclose(found, F.cross_entropy(execution.scores, right))
    assert supervised(execution, some, cells) > found


def test_neighbours_make_a_convolution_over_the_cells_that_are_seen() -> None:
    random = torch.Generator().manual_seed(1)
    features = torch.randn(2, 96, 15, 20, generator=random)
    torch.manual_seed(0)
    candidates = Engine().stem(features)
    cells = cells_of(candidates.seen)
    assert torch.equal(cells, candidates.cells)
    x, kernel = torch.randn(2, 5, 64, generator=random), torch.randn(7, 5, 3, 3, generator=random)
    grid = torch.zeros(2, 5, 15, 20)
    for image in range(2):
        for place, cell in enumerate(cells[image].tolist()):
            grid[image, :, cell // 20, cell % 20] = x[image, :, place]
    wanted = F.conv2d(grid, kernel, padding=1).flatten(2)
    found = kernel.flatten(1) @ neighbours(x, cells)
    for image in range(2):
        assert torch.allclose(found[image], wanted[image][:, cells[image]], atol=1e-5)


@torch.no_grad()
def test_neighbour_modules_with_weights_of_the_middle_alone_are_those_of_the_project() -> None:
    torch.manual_seed(0)
    plain, wide = MapModules(3, 1), NeighbourModules(3, 1)
    state = plain.state_dict()
    for name in ("second", "third"):
        middle = torch.zeros(3, WIDTH, WIDTH, 9)
        middle[..., 4] = state[name]
        state[name] = middle.flatten(2)
    wide.load_state_dict(state)
    candidates = Engine().stem(torch.randn(1, 96, 15, 20))
    inputs = [attend(candidates.logits.expand(2, -1), candidates.seen)]
    chosen = torch.tensor([2, 0])
    found, wanted = (modules(chosen, candidates.seen, inputs).logits for modules in (wide, plain))
    assert torch.allclose(found, wanted, atol=1e-5)


@torch.no_grad()
def test_the_module_of_unique_matters_to_programs_that_have_it_and_to_no_other(mixed: Data) -> None:
    some = mixed.examples[:40]
    has = torch.tensor([any(node.function == "unique" for node in one.program.nodes) for one in some])
    torch.manual_seed(0)
    engine = with_module_of_unique().eval()
    plain = Engine().eval()
    state = engine.state_dict()
    plain.load_state_dict({name: state[name][: len(own)] for name, own in plain.state_dict().items()})
    found = UNIQUE.execute(engine, mixed.features, some).scores
    wanted = AS_IT_IS.execute(plain, mixed.features, some).scores
    assert 0 < int(has.sum()) < len(some)
    assert torch.allclose(found[~has], wanted[~has], atol=1e-5)
    # Before training some later module is often closed to its input, so that the scores stay.
    assert ((found - wanted).abs().amax(1) > 1e-4)[has].double().mean() > 0.5


def test_the_masks_of_unique_are_supervised_too(mixed: Data) -> None:
    some = mixed.examples[:40]
    torch.manual_seed(0)
    engine = with_module_of_unique()
    execution = UNIQUE.execute(engine, mixed.features, some)
    assert execution.assembly == assemble_with_unique(execution.assembly.questions)
    loss = UNIQUE.loss(execution, some, [mixed.cells[example.image] for example in some])
    plain = supervised(execution, some, [mixed.cells[example.image] for example in some])
    (gradient,) = torch.autograd.grad(loss - plain, engine.mapping.mask_bias)
    assert gradient[-1].abs() > 0
