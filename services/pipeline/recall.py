"""What was measured of the scenes of the last jobs, for a warm process whose next job has one of these scenes again."""

from collections import OrderedDict
from collections.abc import Hashable
from typing import Any

from services.scenes.resolve import ResolvedScene

KEPT = 8
"""Scenes. What is measured of one is small, but for its exact images: 5 MB each at 448 by 448 pixels."""

KEPT_SCENES: OrderedDict[str, dict[Hashable, Any]] = OrderedDict()
"""What was measured, by the scene's digest; the scene of the last job is last."""


def recall(scene: ResolvedScene) -> ResolvedScene:
    """The scene, with what was measured of an equal one before. What is measured of it will be recalled in turn."""
    scene.measured.update(KEPT_SCENES.pop(scene.sha256, {}))
    KEPT_SCENES[scene.sha256] = scene.measured
    while len(KEPT_SCENES) > KEPT:
        KEPT_SCENES.popitem(last=False)
    return scene
