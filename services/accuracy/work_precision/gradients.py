"""Estimates of a gradient from values alone, against a reference: differences and random directions."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from services.accuracy.work_precision.signs import wrong_signs
from services.attacks.seeds import generator

IMAGE = "⟨w, image⟩"
"""The function whose gradient is taken where no network is asked: a weighted sum of the image's values."""
DELTAS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
ALONG = 1e-2
"""Half-step of the differences along random directions, in the group's units per unit of the direction."""
WRONG = 0.5
"""An estimate that is further off than this part of the gradient's length is called wrong."""


class GradientRow(BaseModel):
    """One way to estimate the gradient of one function with respect to one group."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    renderer: str
    group: str
    of: str = Field(description="the function: weighted image, or the network's log-odds")
    image: str = Field(description="what the function sees: float64, float32 or 8 bit")
    samples: int | None = Field(description="per pixel, of a rasterised image; null: geometry is fixed")
    estimator: str
    delta: float
    directions: int | None = Field(description="random directions; null: coordinate by coordinate")
    dimensions: int = Field(description="numbers the error is taken over")
    evaluations: int
    error: float = Field(description="relative error (L2) of the gradient")
    wrong_signs: float = Field(description="share of coordinates whose sign is wrong")
    wrong_weight: float = Field(description="the same, each coordinate weighted by its part of the gradient")
    floor: float = Field(description="relative uncertainty of the reference: errors below it mean nothing")
    note: str = ""


class Reference(BaseModel):
    """Where the true gradient of a group comes from."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    renderer: str
    group: str
    of: str
    samples: int | None
    how: str
    uncertainty: float


@dataclass(frozen=True)
class Objective:
    """A function of n numbers of one group, seen through one or several kinds of image.

    values: points [B, n] to [B, V], one column for each of `images`; gradient [n]: the reference; coordinates [k]:
    those that are differenced one by one; resolution: the type in which the renderer takes the numbers.
    """

    renderer: str
    group: str
    of: str
    images: tuple[str, ...]
    at: Tensor
    coordinates: Tensor
    values: Callable[[Tensor], Tensor]
    gradient: Tensor
    how: str
    uncertainty: float = 0.0
    samples: int | None = None
    resolution: torch.dtype = torch.float64

    @property
    def reference(self) -> Reference:
        """The reference as the report lists it."""
        return Reference(
            renderer=self.renderer,
            group=self.group,
            of=self.of,
            samples=self.samples,
            how=self.how,
            uncertainty=self.uncertainty,
        )


def differences(of: Objective, deltas: Sequence[float] = DELTAS) -> Iterator[GradientRow]:
    """Central and forward differences at the objective's coordinates, for each step and kind of image.

    As an attack does it, the distance of the points as the renderer takes them divides; of two that are the same the
    estimate is 0.
    """
    at = of.at.to(of.resolution)
    count, wanted = len(of.coordinates), of.gradient[of.coordinates]
    base = of.values(at[None])
    for delta in deltas:
        sides = at.repeat(2, count, 1)
        rows = torch.arange(count)
        for side, sign in enumerate((1, -1)):
            sides[side, rows, of.coordinates] += sign * delta
        values = of.values(sides.flatten(0, 1)).reshape(2, count, -1)
        ahead, behind = sides[:, rows, of.coordinates].double()
        here = at[of.coordinates].double()
        central = _quotient(values[0] - values[1], ahead - behind)
        forward = _quotient(values[0] - base, ahead - here)
        for estimator, found, evaluations in (("central", central, 2 * count), ("forward", forward, count + 1)):
            yield from _rows(of, estimator, delta, None, evaluations, found[None], wanted)


def _quotient(change: Tensor, width: Tensor) -> Tensor:
    """[k, V] by [k]; 0 where the width is."""
    return torch.where(width == 0, 0.0, (change.T / width.where(width != 0, torch.ones_like(width)))).T


def along_directions(of: Objective, counts: Sequence[int]) -> Iterator[GradientRow]:
    """Means of central differences along Gaussian directions (Nesterov and Spokoiny 2017), of all n numbers.

    The expected relative error of the mean of c directions is √((n + 1) / c). For each count the largest number of
    directions is cut into as many independent estimates as it gives, and their root mean square error is reported.
    """
    count, n = max(counts), len(of.at)
    random = generator(0, "work-precision", of.renderer, of.group)
    directions = torch.randn(count, n, generator=random, dtype=torch.float64)
    at = of.at.double()
    sides = torch.cat([at + ALONG * directions, at - ALONG * directions])
    values = of.values(sides.to(of.resolution)).reshape(2, count, -1)
    derivatives = (values[0] - values[1]) / (2 * ALONG)
    for some in counts:
        blocks = count // some
        estimates = torch.einsum(
            "bcv,bcn->bnv",
            derivatives[: blocks * some].reshape(blocks, some, -1),
            directions[: blocks * some].reshape(blocks, some, n),
        )
        yield from _rows(of, "random directions", ALONG, some, 2 * some, estimates / some, of.gradient)


def _rows(
    of: Objective,
    estimator: str,
    delta: float,
    directions: int | None,
    evaluations: int,
    found: Tensor,
    wanted: Tensor,
) -> Iterator[GradientRow]:
    """A row for each kind of image, of estimates [blocks, n, V]."""
    for v, image in enumerate(of.images):
        off = (found[..., v] - wanted).square().sum(1).mean().sqrt() / wanted.norm()
        error, wrong = float(off), wrong_signs(found[..., v], wanted)
        yield GradientRow(
            renderer=of.renderer,
            group=of.group,
            of=of.of,
            image=image,
            samples=of.samples,
            estimator=estimator,
            delta=delta,
            directions=directions,
            dimensions=len(wanted),
            evaluations=evaluations,
            error=error,
            wrong_signs=wrong.share,
            wrong_weight=wrong.weight,
            floor=of.uncertainty,
            note="" if error <= WRONG else f"more than {WRONG:.0%} wrong",
        )
