from collections.abc import Iterator

import pytest
import torch
from cmaes import CMA

from scene_attack.attacks.attack import State
from scene_attack.attacks.cma_es import CMAES
from scene_attack.attacks.problem import AttackProblem, at_random_start, evaluate
from tests.unit.attacks.small import Bowl, FreeRenderer, LinearRenderer, Pixels, problem, stepped

LIMITS = {"a": 0.3, "b": 0.1}


def settings(epsilon: dict[str, float], **given: object) -> CMAES:
    spread = {group: limit / 3 for group, limit in epsilon.items()}
    return CMAES.model_construct(**({"epsilon": epsilon, "spread": spread, "population": None} | given))  # type: ignore[arg-type]


def bowl(seed: int = 0, **given: object) -> tuple[AttackProblem, dict[str, torch.Tensor]]:
    """A problem whose objective is the squared distance of the image from that of a known perturbation."""
    renderer = FreeRenderer()
    bottom = {
        "a": torch.tensor([[0.1, -0.05, 0.2], [0.0, 0.15, -0.1]], dtype=torch.float64),
        "b": torch.tensor([0.05, -0.02, 0.08], dtype=torch.float64),
    }
    image = renderer.render({group: value[None] for group, value in bottom.items()})[0]
    return problem(renderer, Bowl(image), epsilon=LIMITS, seed=seed, **given), bottom


def generations(case: AttackProblem, attack: CMAES, count: int) -> Iterator[State]:
    """The state after each step, as the loop takes it."""
    state = attack.init(case)
    for step in range(count):
        state = stepped(case, attack, state, step)
        yield state


def test_it_finds_the_bottom_of_a_convex_function() -> None:
    case, bottom = bowl()
    begin = float(case.goal.advantage(case.target.logits(case.original)))
    *_, state = generations(case, settings(LIMITS), 120)
    assert float(state["objective"]) < 1e-6 * begin
    torch.testing.assert_close(state["delta"], case.layout.flatten(bottom), rtol=0, atol=2e-3)


def test_a_generation_asks_for_its_population_and_keeps_the_best() -> None:
    case, _ = bowl()
    attack, queries, objectives = settings(LIMITS, population=7), 0, []
    assert attack.measured(case, attack.init(case)) == {"population": 7, "covariance": "full"}
    for state in generations(case, attack, 10):
        queries += 1 + 7  # the loop's own look
        assert case.counts.queries == queries
        objectives.append(float(state["objective"]))
        at = case.render(state["delta"][None])
        assert float(case.goal.advantage(case.target.logits(at))) == pytest.approx(objectives[-1])
    assert objectives == sorted(objectives, reverse=True)


def test_members_stay_within_the_bounds() -> None:
    case = problem(LinearRenderer(), epsilon={"a": 0.02, "b": 0.5})  # b is between 0 and 1, and begins at 0
    seen: list[dict[str, torch.Tensor]] = []
    true = case.renderer.render

    def render(parameters: dict[str, torch.Tensor]) -> torch.Tensor:
        seen.append(parameters)
        return true(parameters)

    case.renderer.render = render  # type: ignore[assignment, method-assign]
    list(generations(case, settings({"a": 0.02, "b": 0.5}), 10))
    assert max(float(one["a"].abs().max()) for one in seen) <= 0.02
    assert min(float(one["b"].min()) for one in seen) >= 0
    assert max(float(one["b"].max()) for one in seen) > 0.1


def test_a_restart_draws_around_its_own_beginning() -> None:
    case = at_random_start(bowl()[0], 1, 4)
    for state in generations(case, settings(LIMITS, spread={"a": 1e-4, "b": 1e-4}), 3):
        assert float((state["delta"] - case.start).abs().max()) < 2e-3 < float(case.start.abs().max())


def test_members_are_pulled_back_before_they_are_asked_about() -> None:
    """With the constraint `backtrack` the image of the best is within U, and its objective is that image's."""
    case, _ = bowl(backtrack=8 / 255)
    for state in generations(case, settings(LIMITS), 5):
        image = case.renderer.render(case.layout.unflatten((case.initial + state["delta"])[None]))
        assert float((image - case.original).abs().max()) <= 8 / 255
        assert float(case.goal.advantage(case.target.logits(image))) == pytest.approx(float(state["objective"]))


def test_the_first_generation_is_the_packages_own() -> None:
    """The same members as cmaes draws for the same mean, step size, bounds and seed, in units of the spread."""
    from scene_attack.attacks.problem import derived

    case, _ = bowl(seed=4)
    spread = case.layout.spread({"a": 0.1, "b": 0.1 / 3}).numpy()
    limits = case.layout.spread(LIMITS).numpy() / spread
    import numpy as np

    package = CMA(mean=np.zeros(9), sigma=1.0, bounds=np.stack([-limits, limits], axis=1), population_size=6)
    package.reseed_rng(derived(4, "cma-es", 0) % 2**32)
    members = torch.from_numpy(np.stack([package.ask() for _ in range(6)]) * spread)
    moved = case.layout.unflatten(case.initial + members)
    objectives = case.goal.advantage(case.target.logits(case.renderer.render(moved)))
    [state] = generations(case, settings(LIMITS, population=6), 1)
    torch.testing.assert_close(state["delta"], members[int(objectives.argmin())])


@pytest.mark.parametrize("kind", ["full", "diagonal"])
def test_a_resumed_attack_goes_on_bit_for_bit(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if kind == "full":
        (case, _), limits = bowl(), LIMITS
    else:
        monkeypatch.setattr("scene_attack.attacks.cma_es.LARGEST_COVARIANCE", 8)  # the 60 pixels are more
        case, limits = (
            problem(Pixels(), Bowl(torch.zeros(4, 5, 3, dtype=torch.float64)), epsilon={"image": 0.1}),
            {"image": 0.1},
        )
    assert settings(limits).measured(case, settings(limits).init(case))["covariance"] == kind
    begin = float(case.goal.advantage(case.target.logits(case.original)))
    whole = rest = settings(limits).init(case)
    for step in range(12):
        whole = stepped(case, settings(limits), whole, step)
        if step == 5:
            rest = {name: value.clone() for name, value in whole.items()}
        elif step > 5:
            rest = stepped(case, settings(limits), rest, step)
    for name, value in whole.items():
        if "funhist" not in name:  # the package's memory of former generations begins uninitialised
            assert torch.equal(value, rest[name]), name
    assert float(whole["objective"]) < begin


@pytest.mark.parametrize(("allowed", "reached"), [(1.5, 1.0), (0.5, 0.5)])
def test_without_an_epsilon_it_goes_as_far_as_the_limit_on_p_allows(allowed: float, reached: float) -> None:
    """The bottom of the bowl is at p; a search that may go further ends there, another at its limit. Backtracking keeps
    1 % from the limit and is content with 4 % less, so a limit just beyond p would offer the search a second bottom."""
    renderer = FreeRenderer()
    bottom = {"a": torch.full((1, 2, 3), 0.3, dtype=torch.float64), "b": torch.full((1, 3), -0.3, dtype=torch.float64)}
    image = renderer.render(bottom)[0]
    p = float((image - renderer.base).square().sum(-1).mean().sqrt())
    case = problem(renderer, Bowl(image), perceptibility=allowed * p)
    *_, state = generations(case, settings({"a": 0.1, "b": 0.1}), 100)
    change = evaluate(case, state["delta"], 0).image[0] - renderer.base
    assert 0.95 * reached * p < float(change.square().sum(-1).mean().sqrt()) < 1.01 * reached * p
