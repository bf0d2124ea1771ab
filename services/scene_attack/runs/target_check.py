"""Tries a target on a view of a mesh or a generated scene: its card, its answers, its gradient and its speed."""

import time
from collections.abc import Callable

import torch
from pydantic import BaseModel, Field

from scene_attack.rendering.color import from_bytes
from scene_attack.runs.prepare import prepare_exactly
from scene_attack.runs.spec import TargetChoice, parse
from scene_attack.runs.task_parts import Member, models_of
from scene_attack.scenes.description import Scene
from scene_attack.scenes.library import Library
from scene_attack.targets import registry
from scene_attack.targets.info import TargetInfo
from scene_attack.targets.protocol import Target

BATCHES = (1, 8)
"""Numbers of images whose time is measured."""
_TOP = 5
_REPEATS = 3


class TopAnswer(BaseModel):
    """One of the network's most probable labels."""

    label: str
    probability: float


class TargetCheck(BaseModel):
    """A target that loads and answers."""

    target: TargetInfo
    weights_sha256: str
    backend: str
    mesh: str | None = Field(description="the mesh that was shown; null if it was a generated scene after CLEVR")
    asked: str | None = Field(description="what it was asked, in words; null for a target that is asked nothing")
    answers: list[TopAnswer] = Field(description="the most probable labels of its view, the most probable first")
    gradient: bool = Field(description="whether scores have a gradient with respect to the image")
    no_gradient: str | None = Field(description="the reason for which they have none")
    seconds: dict[int, float] = Field(description="number of images in a batch to seconds for each image, scores only")


def check(name: str, mesh: str, library: Library, report: Callable[[str], None] = lambda _: None) -> TargetCheck:
    """Loads the target and shows it a view of the mesh from the default camera. `report` is given each phase's name.

    A target that is asked something is asked the example of its task, about a scene of the task's own if it has one.
    Raises InvalidRequest and JobFailure, as preparing a job does.
    """
    report("loading the network and rendering a view")
    card = registry.card(name)
    scene = Scene.model_validate({"objects": [{"mesh": mesh}]})
    shown = next((ask.example(card, scene) for ask in models_of("ask", name)), Member(scene))
    target_of = TargetChoice(name=name, ask=shown.ask)
    attack = {"renderer": "pyrender"}
    prepared = prepare_exactly(parse({"scene": shown.scene, "target": target_of, "attack": attack}), library)
    target = prepared.target
    probabilities = torch.softmax(prepared.original.logits.double(), dim=-1)
    best = probabilities.topk(min(_TOP, len(target.labels)))
    report("looking for a gradient")
    gradient = registry.has_gradient(name)
    seconds = {}
    image = from_bytes(prepared.original.saved)[None]
    for count in BATCHES:
        report(f"timing batches of {count}")
        seconds[count] = _seconds(target, image.expand(count, -1, -1, -1)) / count
    return TargetCheck(
        target=card,
        weights_sha256=target.weights_sha256,
        backend=target.backend,
        mesh=mesh if shown.scene is scene else None,
        asked=None if shown.ask is None else shown.ask.name,
        answers=[
            TopAnswer(label=target.labels[int(index)], probability=float(value))
            for value, index in zip(best.values, best.indices, strict=True)
        ],
        gradient=gradient,
        no_gradient=None if gradient else registry.no_gradient(name),
        seconds=seconds,
    )


@torch.no_grad()
def _seconds(target: Target, images: torch.Tensor) -> float:
    """Seconds of the fastest of a few passes; the first pass of a network is slower and not counted."""
    durations = []
    for _ in range(_REPEATS + 1):
        begun = time.perf_counter()
        target.logits(images)
        durations.append(time.perf_counter() - begun)
    return min(durations[1:])
