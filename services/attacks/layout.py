"""All attacked groups as one vector, group after group: what methods work on that treat every coordinate alike."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from services.rendering.protocol import Parameters


@dataclass(frozen=True)
class Layout:
    """Where each group's coordinates are in the vector."""

    groups: tuple[str, ...]
    shapes: dict[str, torch.Size]
    starts: dict[str, int]
    total: int

    @classmethod
    def of(cls, values: Mapping[str, Tensor]) -> "Layout":
        """The layout of groups, in their order."""
        starts, total = {}, 0
        for group, value in values.items():
            starts[group] = total
            total += value.numel()
        return cls(tuple(values), {g: v.shape for g, v in values.items()}, starts, total)

    def zeros(self, dtype: torch.dtype = torch.float32) -> Tensor:
        """A vector [total] of zeros."""
        return torch.zeros(self.total, dtype=dtype)

    def group_of(self, coordinate: int) -> str:
        """The group a coordinate of the vector belongs to."""
        return next(g for g in reversed(self.groups) if coordinate >= self.starts[g])

    def flatten(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """One vector of all groups."""
        return torch.cat([parameters[g].flatten() for g in self.groups])

    def unflatten(self, vectors: Tensor) -> Parameters:
        """Vectors [..., total] as groups [..., shape]."""
        lead = vectors.shape[:-1]
        return {
            g: vectors[..., self.starts[g] : self.starts[g] + self.shapes[g].numel()].reshape(*lead, *self.shapes[g])
            for g in self.groups
        }

    def spread(self, by_group: Mapping[str, float]) -> Tensor:
        """Each coordinate with its group's value, float64 [total]."""
        return torch.cat([torch.full((self.shapes[g].numel(),), by_group[g]) for g in self.groups]).double()

    def mask(self, coordinates: Iterable[tuple[str, int]]) -> Tensor:
        """True at coordinates given as group and index within it, bool [total]."""
        found = torch.zeros(self.total, dtype=torch.bool)
        found[[self.starts[group] + index for group, index in coordinates]] = True
        return found
