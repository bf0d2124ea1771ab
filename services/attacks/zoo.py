"""ZOO (Chen et al. 2017; paper, section 3.2): central differences on random coordinates, moved by Adam."""

import torch
from torch import Tensor

from services.attacks.differences import estimate, layout, measure_deltas, measure_noise, where_clamped
from services.attacks.problem import AttackProblem, Evaluation
from services.attacks.seeds import generator
from services.attacks.spec import Zoo
from services.errors import JobFailure
from services.rendering.protocol import Parameters
from services.rendering.pyrender_renderer.inactive import FindsInactive, InactiveCoordinate

BETAS = (0.9, 0.999)
EPSILON = 1e-8
REACH = 10
"""Difference steps are measured where an attack comes in so many steps."""


class ZooMethod:
    """Each step differences a random subset of coordinates and moves only those, each with an Adam state of its own.

    A flat difference says nothing about its coordinate: it is counted, and the coordinate's Adam state is left alone.
    Coordinates that provably change no pixel at the start are not drawn from, as long as that is still so where the
    attack has come to; the others get their share.
    """

    needs_gradient = False

    def __init__(self, settings: Zoo, problem: AttackProblem) -> None:
        self.settings = settings
        self.where = layout(problem)
        self.flat = torch.zeros(self.where.total)
        self.first = torch.zeros(self.where.total, dtype=torch.float64)
        self.second = torch.zeros(self.where.total, dtype=torch.float64)
        self.moves = torch.zeros(self.where.total, dtype=torch.int64)
        self.deltas = torch.zeros(self.where.total, dtype=torch.float64)
        self.idle = torch.zeros(self.where.total, dtype=torch.bool)
        self.noise = 0.0

    @property
    def perturbation(self) -> Parameters:
        """The current perturbation, by group."""
        return self.where.unflatten(self.flat)

    def start(self, problem: AttackProblem) -> dict[str, object]:
        """Measures the noise of the objective and, where asked, each group's difference step; finds what to skip."""
        self.noise = measure_noise(problem, self.flat)
        delta = self.settings.delta
        if isinstance(delta, str):
            chosen = measure_deltas(problem, REACH * self._rates(), self.noise)
        else:
            chosen = delta if isinstance(delta, dict) else dict.fromkeys(self.where.groups, delta)
        self.deltas = self._per_coordinate(chosen)
        found = self._find_idle(problem)
        self.idle = self._mask(found)
        skipped = [{"coordinate": one.name, "why": one.why} for one in found]
        return {"delta": chosen, "noise": self.noise, "skipped": skipped}

    def advance(self, problem: AttackProblem, view: Evaluation, step: int) -> int:  # noqa: ARG002
        """Differences, then Adam on the coordinates that were not flat. Returns how many were."""
        random = generator(problem.seed, "zoo", step)
        pool = self._pool(problem)
        chosen = pool[torch.randperm(len(pool), generator=random)[: self.settings.coordinates]].sort().values
        found = estimate(problem, self.flat, chosen, self.deltas[chosen], self.noise)
        if not bool(torch.isfinite(found.slopes).all()):
            raise JobFailure("non-finite", "a difference of the objective is not finite")
        moving, slopes = chosen[~found.flat], found.slopes[~found.flat]
        self.moves[moving] += 1
        self.first[moving] = BETAS[0] * self.first[moving] + (1 - BETAS[0]) * slopes
        self.second[moving] = BETAS[1] * self.second[moving] + (1 - BETAS[1]) * slopes.square()
        first = self.first[moving] / (1 - BETAS[0] ** self.moves[moving].double())
        second = self.second[moving] / (1 - BETAS[1] ** self.moves[moving].double())
        rates = self._rates()[moving]
        self.flat[moving] -= (rates * first / (second.sqrt() + EPSILON)).to(self.flat.dtype)
        self.flat = where_clamped(problem, self.flat[None], self.where)[0]
        return int(found.flat.sum())

    def state(self) -> dict[str, Tensor]:
        """Perturbation, Adam's moments and counts, difference steps, what was idle, and noise."""
        return {
            "flat": self.flat,
            "first": self.first,
            "second": self.second,
            "moves": self.moves,
            "deltas": self.deltas,
            "idle": self.idle,
            "noise": torch.tensor(self.noise, dtype=torch.float64),
        }

    def load(self, state: dict[str, Tensor]) -> None:
        """Continues from `state()`."""
        self.flat, self.first, self.second = state["flat"], state["first"], state["second"]
        self.moves, self.deltas, self.noise = state["moves"], state["deltas"], float(state["noise"])
        self.idle = state["idle"]

    def _find_idle(self, problem: AttackProblem) -> list[InactiveCoordinate]:
        """The attacked coordinates that change no pixel where the attack is, moved by their difference step."""
        if not isinstance(problem.renderer, FindsInactive):
            return []
        reach = {g: float(self.deltas[self.where.starts[g]]) for g in self.where.groups}
        at = {g: problem.initial[g] + value for g, value in self.perturbation.items()}
        return [one for one in problem.renderer.idle(at, reach) if one.group in self.where.groups]

    def _mask(self, found: list[InactiveCoordinate]) -> Tensor:
        mask = torch.zeros(self.where.total, dtype=torch.bool)
        mask[[self.where.starts[one.group] + one.index for one in found]] = True
        return mask

    def _pool(self, problem: AttackProblem) -> Tensor:
        """The coordinates to draw from. Those once idle are examined again; none ever was in most scenes."""
        still = self.idle & self._mask(self._find_idle(problem)) if bool(self.idle.any()) else self.idle
        return (~still).nonzero()[:, 0]

    def _rates(self) -> Tensor:
        rate = self.settings.learning_rate
        return self._per_coordinate(rate if isinstance(rate, dict) else dict.fromkeys(self.where.groups, rate))

    def _per_coordinate(self, by_group: dict[str, float]) -> Tensor:
        parts = [torch.full((self.where.shapes[g].numel(),), by_group[g]) for g in self.where.groups]
        return torch.cat(parts).double()
