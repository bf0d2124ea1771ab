"""Named materials: DSBRDF coefficients fitted to analytic reference BRDFs by scripts/fit_materials.py."""

from functools import lru_cache

import torch
from torch import Tensor

from services.rendering.torch_renderer.dsbrdf import SHAPE
from services.rendering.torch_renderer.preset_names import check_preset, stored_presets


@lru_cache(maxsize=1)
def presets() -> dict[str, Tensor]:
    """Returns all presets, {name: coefficients}, float64 [3, 3, 2, 6].

    The coefficients are natural logarithms of κ and γ, for a white base colour.
    """
    return {
        name: torch.tensor(fit["coefficients"], dtype=torch.float64).reshape(SHAPE)
        for name, fit in stored_presets().items()
    }


def preset(name: str, field: str = "material") -> Tensor:
    """Returns the coefficients of one preset, float64 [3, 3, 2, 6].

    Raises InvalidRequest(field, …) with the nearest names for an unknown name.
    """
    check_preset(name, field)
    return presets()[name].clone()


def colored_lobes(name: str, field: str = "material") -> tuple[bool, ...]:
    """Returns for each lobe of a preset whether the mesh's colour multiplies what it reflects.

    So it is for the body of any material and for the gloss of metals; the gloss of others keeps the light's colour.
    Raises InvalidRequest as `preset` does.
    """
    preset(name, field)
    return tuple(stored_presets()[name]["colored_lobes"])
