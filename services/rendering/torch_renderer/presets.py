"""Named materials: DSBRDF coefficients fitted to analytic reference BRDFs by scripts/fit_materials.py."""

import json
from functools import lru_cache
from importlib.resources import files
from typing import Any

import torch
from torch import Tensor

from services.errors import InvalidRequest
from services.rendering.torch_renderer.dsbrdf import SHAPE
from services.suggestions import did_you_mean


@lru_cache(maxsize=1)
def _committed() -> dict[str, dict[str, Any]]:
    text = files("services.rendering.torch_renderer").joinpath("presets.json").read_text()
    found: dict[str, dict[str, Any]] = json.loads(text)["presets"]
    return found


@lru_cache(maxsize=1)
def presets() -> dict[str, Tensor]:
    """Returns all presets, {name: coefficients}, float64 [3, 3, 2, 6].

    The coefficients are natural logarithms of κ and γ, for a white base colour.
    """
    return {
        name: torch.tensor(fit["coefficients"], dtype=torch.float64).reshape(SHAPE)
        for name, fit in _committed().items()
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


def colored_lobes(name: str, field: str = "material") -> tuple[bool, ...]:
    """Returns for each lobe of a preset whether the mesh's colour multiplies what it reflects.

    So it is for the body of any material and for the gloss of metals; the gloss of others keeps the light's colour.
    Raises InvalidRequest as `preset` does.
    """
    preset(name, field)
    return tuple(_committed()[name]["colored_lobes"])
