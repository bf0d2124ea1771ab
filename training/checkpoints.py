"""The file from which an interrupted training goes on."""

import io
import pickle
from pathlib import Path
from typing import Any

import torch

from services import disk
from services.errors import InvalidRequest, summary


def write(path: Path, about: Any, state: dict[str, Any]) -> None:
    """Writes a checkpoint of the training that `about` names: after a kill it is the old or the new one, complete."""
    buffer = io.BytesIO()
    torch.save({"about": about} | state, buffer)
    disk.write(path, buffer.getvalue())


def read(path: Path, about: Any) -> dict[str, Any]:
    """Returns the state in a checkpoint. Raises InvalidRequest("--out") if it is damaged, or of another training."""
    try:
        state: dict[str, Any] = torch.load(path, weights_only=True)
    except (RuntimeError, EOFError, OSError, ValueError, pickle.UnpicklingError) as error:
        why = f"{path} is damaged ({summary(error)}); delete it, and that part is trained anew"
        raise InvalidRequest("--out", why) from error
    if state["about"] != about:
        raise InvalidRequest("--out", f"{path} is a checkpoint of {state['about']}, not of {about}; move it away")
    return state
