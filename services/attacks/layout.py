"""All attacked groups as one vector, group after group, for methods that treat every coordinate alike."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from services.rendering.protocol import Parameters


@dataclass(frozen=True)
class Layout:
    """The position of each group's coordinates in a vector of length `total`."""

    groups: tuple[str, ...]
    shapes: dict[str, torch.Size]
    starts: dict[str, int]
    total: int

    @classmethod
    def of(cls, values: Mapping[str, Tensor]) -> "Layout":
        """The layout of the groups in `values`, in their order."""
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
        """The groups' values, each of its group's shape, as one vector [total]."""
        return torch.cat([parameters[g].flatten() for g in self.groups])

    def unflatten(self, vectors: Tensor) -> Parameters:
        """Vectors [..., total] as tensors [..., *shape], by group."""
        lead = vectors.shape[:-1]
        return {
            g: vectors[..., self.starts[g] : self.starts[g] + self.shapes[g].numel()].reshape(*lead, *self.shapes[g])
            for g in self.groups
        }

    def spread(self, by_group: Mapping[str, float]) -> Tensor:
        """A vector, float64 [total], in which every coordinate has its group's value."""
        return torch.cat([torch.full((self.shapes[g].numel(),), by_group[g], dtype=torch.float64) for g in self.groups])

    def mask(self, coordinates: Iterable[tuple[str, int]]) -> Tensor:
        """A mask, bool [total], that is true at the given (group, flat index within the group)."""
        found = torch.zeros(self.total, dtype=torch.bool)
        found[[self.starts[group] + index for group, index in coordinates]] = True
        return found
