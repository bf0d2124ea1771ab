"""The device on which networks and the torch renderer compute (SCENE_ATTACK_DEVICE), and a test of tensors for
infinities and NaN.

The API checks the setting too, and it loads no torch: nothing here imports it before it is needed.
"""

import os
from math import isfinite
from typing import TYPE_CHECKING

from services.errors import InvalidRequest
from services.process import options

if TYPE_CHECKING:
    import torch
    from torch import Tensor


def device() -> "torch.device":
    """Returns the device of the setting; "auto" is the first CUDA device if there is one, else the CPU.

    Raises InvalidRequest, naming the setting, for a device that does not exist.
    """
    import torch

    name = options().device
    if name == "cpu" or (name == "auto" and not torch.cuda.is_available()):
        return torch.device("cpu")
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    index = int(name.partition(":")[2] or 0)
    if index >= count:
        there = f"{count} CUDA device{'s' if count > 1 else ''}, numbered from 0" if count else "no CUDA device"
        raise InvalidRequest(f"SCENE_ATTACK_DEVICE={name}", f"this machine has {there}; use auto or cpu")
    _make_deterministic()
    return torch.device("cuda", index)


def check_device() -> None:
    """Raises InvalidRequest, naming the setting, where the device is not there. Imports torch only to look for CUDA."""
    if options().device not in ("auto", "cpu"):
        device()


def describe(where: "torch.device") -> str:
    """Returns a device's part of a backend string: "cpu", or the CUDA device and its model."""
    import torch

    return where.type if where.type != "cuda" else f"{where} ({torch.cuda.get_device_name(where)})"


def _make_deterministic() -> None:
    """Makes CUDA's libraries deterministic, and turns off TensorFloat-32."""
    import torch

    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # read when cuBLAS is first used
    torch.backends.cudnn.allow_tf32 = False
    torch.backends.cudnn.benchmark = False
    torch.use_deterministic_algorithms(True, warn_only=True)


def finite(values: "Tensor") -> bool:
    """Returns whether every value is finite. The minimum and maximum, which a single pass computes, suffice."""
    low, high = values.detach().aminmax()
    return isfinite(float(low)) and isfinite(float(high))
