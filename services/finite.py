"""Tests tensors for infinities and NaN."""

from math import isfinite

import torch
from torch import Tensor


def finite(values: Tensor) -> bool:
    """Returns whether every value is finite. The minimum and maximum, which a single pass computes, suffice."""
    low, high = torch.aminmax(values.detach())
    return isfinite(float(low)) and isfinite(float(high))
