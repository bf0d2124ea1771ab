"""Writes perturbations as safetensors files that say what their numbers are."""

import json
from pathlib import Path

from safetensors.torch import save_file

from services.rendering.declaration import RENDERERS
from services.rendering.protocol import Parameters, Renderer

PERTURBATION = "perturbation.safetensors"


def save_perturbation(perturbation: Parameters, renderer: Renderer, path: Path) -> None:
    """Writes one tensor for each group: its change from the scene's own values, `describe` as metadata."""
    tensors = {group: value.contiguous() for group, value in perturbation.items()}
    # One entry: the library writes several in an order of its own, and the same job gives the same bytes.
    save_file(tensors, path, metadata={"groups": describe(perturbation, renderer)})


def describe(perturbation: Parameters, renderer: Renderer) -> str:
    """JSON: for each group its unit, its axes and, where they have names, its coordinates in flat order."""
    declared = {group.name: group for group in RENDERERS[renderer.name].groups}
    found = {
        group: {
            "unit": declared[group].unit,
            "axes": list(declared[group].shape),
            "names": renderer.names(group),
            "values": "change from the scene's own values",
        }
        for group in sorted(perturbation)
    }
    return json.dumps(found, ensure_ascii=False)
