"""Real jobs that are over in a second or two."""

from typing import Any

from scene_attack.runs.spec import JobSpec, parse
from scene_attack.scenes.library import Library
from scene_attack_service.settings import Settings

LIBRARY = Library(Settings().cache_dir, Settings().data_dir)
SPHERE = {"objects": [{"mesh": "primitive/sphere"}], "camera": {"size": [64, 64]}}


def spec(attack: dict[str, Any] | None = None, **changes: Any) -> JobSpec:
    """A sphere at 64², attacked for three steps."""
    scene = SPHERE | changes.pop("scene", {})
    return parse({"scene": scene, "attack": {"steps": 3} | (attack or {})} | changes)
