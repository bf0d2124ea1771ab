"""Where networks and the torch renderer compute: SCENE_ATTACK_DEVICE.

Parameters of a renderer and everything an attack remembers are CPU tensors, drawn from CPU generators, wherever images
are computed: a checkpoint means the same on every device. Images are on the renderer's device.
"""

import os
from typing import TYPE_CHECKING

from services.errors import InvalidRequest
from services.settings import settings

if TYPE_CHECKING:
    import torch


def device() -> "torch.device":
    """The device of the setting; "auto" is the first CUDA device where there is one, else the CPU.

    Raises InvalidRequest, naming the setting, for a device that is not there.
    """
    import torch

    wanted = settings().device
    if wanted == "cpu" or (wanted == "auto" and not torch.cuda.is_available()):
        return torch.device("cpu")
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    index = int(wanted.partition(":")[2] or 0)
    if index >= count:
        there = f"{count} CUDA device{'s' if count > 1 else ''}, numbered from 0" if count else "no CUDA device"
        raise InvalidRequest(f"SCENE_ATTACK_DEVICE={wanted}", f"this machine has {there}; use auto or cpu")
    _same_bits_again()
    return torch.device("cuda", index)


def check_device() -> None:
    """Raises InvalidRequest, naming the setting, where the device is not there. Imports torch only to look for CUDA."""
    if settings().device not in ("auto", "cpu"):
        device()


def describe(where: "torch.device") -> str:
    """A device in a backend string: "cpu", or a CUDA device with its model."""
    import torch

    return where.type if where.type != "cuda" else f"{where} ({torch.cuda.get_device_name(where)})"


def _same_bits_again() -> None:
    """Let CUDA's libraries choose the same algorithms in every run, in float32 where float32 is asked for."""
    import torch

    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # read when cuBLAS is first used
    torch.backends.cudnn.allow_tf32 = False
    torch.backends.cudnn.benchmark = False
    torch.use_deterministic_algorithms(True, warn_only=True)
