"""Makes the analyses that a request asks for, of a perturbation that was just found or is stored in a result.

The re-rendering defence is also made of an image alone, whose scene is known.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch
from pydantic import BaseModel
from torch import Tensor

from scene_attack.analysis.attribution import Tick, of_coordinates, of_subsets
from scene_attack.analysis.expectation import survival
from scene_attack.analysis.images import save_png
from scene_attack.analysis.minimal import minimal_change
from scene_attack.analysis.records import (
    Analyses,
    AnalysisRequest,
    Attribution,
    Rerendering,
    RerenderingRequest,
    Subset,
    Transferred,
)
from scene_attack.analysis.rerendering import attack_through, interpret, rerender
from scene_attack.analysis.second_opinion import second_opinion
from scene_attack.analysis.subsets import ScoredImage, scored, subsets
from scene_attack.analysis.transfer import Wanted, indices, shown_to
from scene_attack.attacks.problem import Counts
from scene_attack.attacks.run import Verifier
from scene_attack.errors import InvalidRequest
from scene_attack.rendering.factory import build
from scene_attack.rendering.physical_change import physical_changes
from scene_attack.rendering.plan import Tolerance
from scene_attack.rendering.protocol import Parameters
from scene_attack.rendering.torch.declaration import TORCH
from scene_attack.runs import classification
from scene_attack.runs.prepare import Prepared, prepare, resolved_scene, task_of
from scene_attack.runs.replay import read_stored
from scene_attack.runs.result import JobWarning
from scene_attack.runs.spec import JobSpec, asked_goal, parse
from scene_attack.scenes.image_file import other_size
from scene_attack.scenes.library import Library
from scene_attack.scenes.reading.isolated import reader
from scene_attack.scenes.resolve import ResolvedScene
from scene_attack.targets import registry
from scene_attack.targets.labels import same_labels
from scene_attack.targets.protocol import Target

Report = Callable[[str, int, int], None]
"""Called before each image with the name of the analysis, the number of its images done and the number there may be."""


@dataclass(frozen=True)
class Subject:
    """A job's stored perturbation, the images and scores of its two ends, and whether it is a verified adversary."""

    prepared: Prepared
    perturbation: Parameters
    original: ScoredImage
    attacked: ScoredImage
    verified: bool


NO_ADVERSARY = JobWarning(
    code="left-out",
    field="analysis",
    text="a second opinion and survival are of verified adversaries; this is none, so they were not made",
)


def not_made(request: AnalysisRequest, verified: bool) -> list[JobWarning]:
    """A warning if a request has analyses that are of verified adversaries alone, and this is none."""
    asks = request.second_opinion is not None or request.survival is not None
    return [NO_ADVERSARY] if asks and not verified else []


def analyse(subject: Subject, request: AnalysisRequest, out: Path, report: Report) -> Analyses:
    """Makes the analyses, and writes their images into the folder `out`.

    Raises JobFailure, and what `report` raises, which may be Cancelled.
    """
    prepared, perturbation = subject.prepared, subject.perturbation
    original, attacked = subject.original, subject.attacked
    verifier, goal = prepared.verifier, prepared.settled.goal
    analyses = Analyses()
    if request.coordinates is not None:
        tick, seed = partial(report, "coordinates"), prepared.spec.seed
        analyses.coordinates = of_coordinates(
            verifier, goal, perturbation, original, attacked, request.coordinates, seed=seed, tick=tick
        )
    if request.minimal is not None:
        words = partial(physical_changes, prepared.scene, prepared.renderer)
        analyses.minimal = minimal_change(
            verifier, goal, perturbation, original, request.minimal, physical=words, tick=partial(report, "minimal")
        )
    if request.transfer is not None:
        analyses.transfer = []
        for number, name in enumerate(request.transfer.targets):
            report("transfer", number, len(request.transfer.targets))
            analyses.transfer.append(_to_target(subject, name))
    if request.second_opinion is not None and subject.verified:
        analyses.second_opinion = []
        for number, name in enumerate(request.second_opinion.renderers):
            report("second opinion", number, len(request.second_opinion.renderers))
            wanted = _wanted(prepared, prepared.target.name, prepared.target.labels)
            opinion, images = second_opinion(
                prepared.scene, prepared.renderer.name, perturbation, name, prepared.target, wanted
            )
            analyses.second_opinion.append(opinion)
            for file, image in images.items():
                save_png(image, out / file)
    if request.survival is not None and subject.verified:
        tick, seed = partial(report, "survival"), prepared.spec.seed
        analyses.survival = survival(
            verifier, goal, prepared.right, original.exact, attacked.exact, request.survival, seed=seed, tick=tick
        )
    if any((request.interpretation, request.rerendering, request.adaptive)):
        fitting = _fitting(prepared.scene, prepared.spec.tolerance, prepared.target)
        if request.interpretation is not None:
            tick, steps = partial(report, "interpretation"), request.interpretation.steps
            analyses.interpretation = interpret(fitting, attacked.saved, steps, tick)
        if request.rerendering is not None:
            tick = partial(report, "rerendering")
            analyses.rerendering, _ = rerender(fitting, attacked.saved, request.rerendering, tick)
        if request.adaptive is not None:
            tick, fit, steps = partial(report, "adaptive"), request.adaptive.fit, request.adaptive.steps
            analyses.adaptive = attack_through(fitting, goal, original.saved, fit=fit, steps=steps, tick=tick)
    return analyses


def _fitting(scene: ResolvedScene, tolerance: Tolerance, target: Target) -> Verifier:
    """The torch renderer of a scene, for fits of all its groups, and the network that answers for them."""
    return Verifier(build(scene, TORCH.name, tolerance=tolerance), target)


def _to_target(subject: Subject, name: str) -> Transferred:
    prepared = subject.prepared
    other = replace(prepared.verifier, target=registry.load(name), counts=Counts())
    goal = _wanted(prepared, name, other.target.labels)
    return shown_to(other, goal, subject.original.saved, subject.attacked.saved)


def _wanted(prepared: Prepared, target: str, labels: tuple[str, ...]) -> Wanted:
    """The job's truth and label to reach for another network: by name, or else by what its own table says is right."""
    card, own = registry.card(target), prepared.target.labels
    names = [own[index] for index in prepared.settled.truth]
    meshes = [thing.mesh for thing in prepared.spec.scene.objects]
    reach = prepared.settled.goal.reach
    return Wanted(
        truth=classification.for_another(names, registry.card(prepared.target.name), meshes, card, labels),
        reach=labels.index(own[reach]) if reach is not None and own[reach] in labels else None,
        same=tuple(indices(group, labels) for group in same_labels(card)),
        least_confidence=prepared.settled.goal.least_confidence,
    )


class StoredAnalysis(BaseModel):
    """The table of subsets and the groups' Shapley values, made anew, the analyses that were asked for, and warnings of
    those that were not made."""

    subsets: list[Subset]
    attribution: Attribution
    analyses: Analyses
    warnings: list[JobWarning]


def analyse_stored(directory: Path, request: AnalysisRequest, library: Library, report: Report) -> StoredAnalysis:
    """Analyses the result in a directory. Raises InvalidRequest as `read_stored` and `prepare` do, and if a
    file does not belong to the others.
    """
    stored = read_stored(directory)
    spec = parse(stored.result.spec | {"analysis": request.model_dump(mode="json")})
    prepared = prepare(spec, library)
    verifier = prepared.verifier
    stored.check(prepared.renderer.initial(), spec.attack.groups)
    perturbation = {group: stored.perturbation[group] for group in spec.attack.groups}  # in the order of tables
    ends = prepared.original, scored(verifier, perturbation)
    rows = subsets(verifier, prepared.settled.goal, perturbation, *ends)
    verified = stored.result.verdict.verified and bool(prepared.settled.goal.fooled(ends[1].logits))
    analyses = analyse(Subject(prepared, perturbation, *ends, verified), request, directory, report)
    warnings = not_made(request, verified)
    return StoredAnalysis(subsets=rows, attribution=of_subsets(rows), analyses=analyses, warnings=warnings)


def rerender_image(
    image: Tensor, spec: JobSpec, request: RerenderingRequest, library: Library, tick: Tick
) -> tuple[Rerendering, Tensor]:
    """Fits the scene of a spec to an image, uint8 [H, W, 3], and asks the spec's target about image and rendering.

    Returns the record and the rendering, uint8 [H, W, 3]. Raises InvalidRequest("image") for an image that is not of
    the camera's size, and as `resolve` and the target's registry do.
    """
    size, due = (image.shape[0], image.shape[1]), spec.scene.camera.size
    if size != due:
        raise InvalidRequest("image", other_size(size, due))
    name = spec.target.name
    asked = asked_goal(spec.goal, registry.card(name), registry.labels(name))
    target = task_of(spec, registry.load(name), asked).target
    return rerender(_fitting(resolved_scene(spec, library), spec.tolerance, target), image, request, tick)


def decode_image(data: bytes, size: tuple[int, int]) -> Tensor:
    """Reads a PNG, JPEG or WebP file as uint8 [H, W, 3], whose height and width must be `size`, in another process.

    Raises InvalidRequest("image"). The size is checked before the pixels are read.
    """
    return torch.from_numpy(reader().read_image(data, size).copy())
