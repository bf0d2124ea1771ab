"""The views that benchmarks attack: furniture whose name is an ImageNet class, chosen before any attack was run."""

import json
from collections.abc import Iterator
from pathlib import Path

from scene_attack.errors import InvalidRequest
from scene_attack.runs.prepare import prepare
from scene_attack.runs.spec import parse
from scene_attack.scenes.library import Library

VIEWS = Path(__file__).with_name("views.json")


def right(library: Library, count: int) -> Iterator[tuple[str, str]]:
    """The first `count` views (mesh, label) that the network gets right at the default camera."""
    for mesh, label in json.loads(VIEWS.read_text("utf-8"))["views"]:
        if count == 0:
            return
        try:
            prepared = prepare(parse({"scene": {"objects": [{"mesh": mesh}]}, "goal": {"leave": label}}), library)
        except InvalidRequest:
            continue
        if any(warning.code in ("already-wrong", "truth-unknown") for warning in prepared.settled.warnings):
            continue
        yield mesh, label
        count -= 1
