"""Named materials: DSBRDF coefficients fitted to analytic reference BRDFs by scripts/fit_materials.py."""

import json
from functools import lru_cache
from importlib.resources import files

import torch
from torch import Tensor

from services.errors import InvalidRequest
from services.rendering.torch_renderer.dsbrdf import SHAPE
from services.suggestions import did_you_mean


@lru_cache(maxsize=1)
def presets() -> dict[str, Tensor]:
    """Returns all presets, {name: coefficients}, float64 [3, 3, 2, 6].

    The coefficients are natural logarithms of κ and γ, for a white base colour.
    """
    committed = json.loads(files("services.rendering.torch_renderer").joinpath("presets.json").read_text())
    return {
        name: torch.tensor(fit["coefficients"], dtype=torch.float64).reshape(SHAPE)
        for name, fit in committed["presets"].items()
    }


def preset(name: str, field: str = "material") -> Tensor:
    """Returns the coefficients of one preset, float64 [3, 3, 2, 6].

    Raises InvalidRequest(field, …) with the nearest names for an unknown name.
    """
    known = presets()
    if name not in known:
        hint = did_you_mean(name, known) or f"; there are {', '.join(known)}"
        raise InvalidRequest(field, f"there is no material preset {name!r}{hint}")
    return known[name].clone()
