"""Scenes whose triangles are in the frame, and of which nothing can be seen all the same."""

from typing import Any

import numpy as np
import pytest

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.factory import build
from scene_attack.scenes.resolve import ResolvedScene
from tests.unit.rendering.pyrender.test_gltf_materials import mesh, square
from tests.unit.rendering.shapes import placed, scene

HOLES = np.zeros((4, 4, 4), np.uint8)
UNSEEN: dict[str, dict[str, Any]] = {
    "a mask above its alpha": {
        "alphaMode": "MASK", "alphaCutoff": 0.5, "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.3]},
    },
    "a mask above 1": {"alphaMode": "MASK", "alphaCutoff": 1.5},
    "a texture of holes": {"alphaMode": "MASK", "pbrMetallicRoughness": {"baseColorTexture": HOLES}},
    "blended with opacity 0": {"alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0]}},
}  # fmt: skip


def refused_as_unseen(resolved: ResolvedScene) -> None:
    for renderer in ("torch", "pyrender"):
        for tolerance in ("exact", 1e-3):
            with pytest.raises(InvalidRequest, match="out of view: no object covers any part of the image") as error:
                build(resolved, renderer, tolerance=tolerance)  # type: ignore[arg-type]
            assert error.value.field == "scene.objects"


@pytest.mark.parametrize("name", UNSEEN)
def test_both_renderers_refuse_what_cannot_be_seen(name: str) -> None:
    """pyrender attacked the bare ground."""
    refused_as_unseen(placed(scene(), mesh(square(UNSEEN[name]))))


def test_both_renderers_refuse_a_surface_seen_from_behind_only() -> None:
    """A single-sided face is not drawn from its back."""
    refused_as_unseen(placed(scene(), mesh(square(turned=True))))


def test_a_surface_that_shows_a_little_is_not_refused() -> None:
    """Next to one that does not show at all, or by one sample in sixteen."""
    hidden, shown = mesh(square(UNSEEN["blended with opacity 0"])), mesh(square())
    veil = mesh(square({"alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.04]}}))
    for meshes in ((hidden, shown), (veil,)):
        for renderer in ("torch", "pyrender"):
            assert build(placed(scene(objects=len(meshes)), *meshes), renderer).size == (96, 128)
