"""What was measured of the scenes of the last jobs, for a warm process whose next job has one of these scenes again."""

from collections import OrderedDict
from collections.abc import Hashable, Mapping
from typing import Any

from torch import Tensor

from services.scenes.resolve import ResolvedScene

KEPT = 8
"""Scenes."""
KEPT_BYTES = 2**26
"""Bytes of the tensors that are kept of them all: exact images, of 5 MB each at 448 by 448 pixels."""
KEPT_OF_ONE = 64
"""Measurements of a scene. Each choice of a renderer, of groups and of a tolerance has its own."""

KEPT_SCENES: OrderedDict[str, dict[Hashable, Any]] = OrderedDict()
"""What was measured, by the scene's digest; the scene of the last job is last."""


def recall(scene: ResolvedScene) -> ResolvedScene:
    """The scene, with what was measured of an equal one before. What is measured of it will be recalled in turn."""
    known = KEPT_SCENES.pop(scene.sha256, {})
    if len(known) < KEPT_OF_ONE and _size(known) <= KEPT_BYTES:
        scene.measured.update(known)
    KEPT_SCENES[scene.sha256] = scene.measured
    while len(KEPT_SCENES) > KEPT or (len(KEPT_SCENES) > 1 and sum(map(_size, KEPT_SCENES.values())) > KEPT_BYTES):
        KEPT_SCENES.popitem(last=False)
    return scene


def _size(measured: Mapping[Hashable, Any]) -> int:
    """Bytes of the tensors of measurements, which are tensors or have some beside others."""
    values = (value if isinstance(value, tuple) else (value,) for value in measured.values())
    return sum(part.numel() * part.element_size() for some in values for part in some if isinstance(part, Tensor))
