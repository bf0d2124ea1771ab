"""Whether numbers are numbers."""

from math import isfinite

import torch
from torch import Tensor


def finite(values: Tensor) -> bool:
    """Whether no value is infinite or not a number. Both show in the extremes, and those take one pass."""
    low, high = torch.aminmax(values.detach())
    return isfinite(float(low)) and isfinite(float(high))
