"""Chooses the views of a campaign that are attacked, from the networks' first answers; says why others are not."""

import operator
from collections import Counter
from collections.abc import Mapping, Sequence

from pydantic import BaseModel, ConfigDict, Field

from services.pipeline.campaign_expand import View
from services.pipeline.campaign_spec import Selection
from services.pipeline.names import scene_name
from services.pipeline.spec import JobSpec

UNKNOWN = "nobody knows its truth"


class FirstAnswer(BaseModel):
    """The network's answer to the exact image of a view, as a worker found it."""

    model_config = ConfigDict(extra="forbid")

    view: int
    label: str | None = None
    confidence: float | None = None
    truth: list[str] = Field([], description="the labels that are right; empty if nobody knows them")
    refused: str | None = Field(None, description="why the view cannot be attacked at all")
    programs: list[list[dict[str, object]]] = Field(
        [],
        exclude_if=operator.not_,
        description="the network's programs of the questions that were asked",
    )
    spec: JobSpec | None = Field(None, description="the probe as it would run, with scene and goal filled in")
    identity: str | None = Field(None, description="digest of scene, weights, backend, versions and answer; for reuse")

    @property
    def right(self) -> bool:
        """Whether the truth is known and the answer is right."""
        return self.label in self.truth


class ChosenView(BaseModel):
    """A view of a campaign, and whether it is attacked."""

    model_config = ConfigDict(extra="forbid")

    number: int
    scene: str = Field(description="short name of the scene's meshes")
    questions: list[str] = Field([], exclude_if=operator.not_, description="the questions that are asked about it")
    azimuth: float = Field(description="of the camera, radians")
    target: str
    renderer: str = Field(description="the renderer of the image")
    label: str | None = Field(description="the network's first answer")
    confidence: float | None
    truth: list[str]
    right: bool
    chosen: bool
    why: str = Field(description="why the view is not attacked; empty for a chosen one")


def meshes_of(views: Sequence[View]) -> set[str]:
    """The names of all meshes in the views' scenes."""
    return {thing.mesh for view in views for thing in view.probe.scene.objects}


def choose(
    views: Sequence[View], answers: Mapping[int, FirstAnswer], titles: Mapping[str, str] | None = None
) -> list[ChosenView]:
    """Applies each grid's rules to the views of each target and renderer, and returns all views in their order.

    Of equally confident views the earlier one is taken. A view without an answer is not chosen. `titles` are those of
    uploaded meshes, by name.
    """
    titles = _distinct(titles or {})
    why = {view.number: _unfit(view, answers.get(view.number)) for view in views}
    for group in dict.fromkeys(view.group for view in views):
        units: dict[tuple[int, str], list[View]] = {}
        for view in views:
            if view.group == group:
                units.setdefault(view.unit, []).append(view)
        fit = [unit for unit in units.values() if not any(why[view.number] for view in unit)]
        passed = _not_among_the_preferred([unit[0] for unit in fit], answers)
        for unit in units.values():
            reason = passed.get(unit[0].number, "") or _of_another(unit, why)
            why |= {view.number: why[view.number] or reason for view in unit}
    return [_record(view, answers.get(view.number), why[view.number], titles) for view in views]


def _distinct(titles: Mapping[str, str]) -> dict[str, str]:
    """The titles; one that several uploads have is followed by the beginning of their hash, as tables are by scene."""
    count = Counter(titles.values())
    return {name: title if count[title] == 1 else f"{title} ({name[:14]})" for name, title in titles.items()}


def _unfit(view: View, answer: FirstAnswer | None) -> str:
    if answer is None:
        return "its first answer could not be found"
    if answer.refused is not None:
        return answer.refused
    if view.asked and answer.programs != [one.program.written() for one in view.asked if one.program is not None]:
        return "the network has another program than that of the question"
    rules = view.selection
    if rules is None:
        return ""
    if rules.right and not answer.truth:
        return UNKNOWN
    if rules.right and not answer.right:
        return f"the network says {answer.label}, which is wrong"
    if _confidence(answer) < rules.least_confidence:
        return f"the network is less sure than {rules.least_confidence:g}"
    return ""


def nothing_chosen(views: Sequence[ChosenView]) -> str | None:
    """The most frequent reasons why a campaign attacks none of its views, in a sentence; None if it attacks any."""
    if not views or any(view.chosen for view in views):
        return None
    counted = Counter(view.why for view in views).most_common(3)
    said = "; ".join(f"{why} ({count:,} of {len(views):,})" for why, count in counted)
    hint = " The field goal.truth of a grid states it." if any(why == UNKNOWN for why, _ in counted) else ""
    return f"No view is attacked: {said}.{hint}"


def _of_another(unit: Sequence[View], why: Mapping[int, str]) -> str:
    """The reason for which one of these views is not attacked, and so none; empty if there is none."""
    return next((f"of {view.probe.target.name}: {why[view.number]}" for view in unit if why[view.number]), "")


def _not_among_the_preferred(own: Sequence[View], answers: Mapping[int, FirstAnswer]) -> dict[int, str]:
    rules = own[0].selection if own else None
    if rules is None:
        return {}
    listed = rules.prefer == "listed"
    ranked = sorted(own, key=lambda view: (0.0 if listed else -_confidence(answers[view.number]), view.number))
    meshes: Counter[str] = Counter()
    classes: Counter[tuple[str, ...]] = Counter()
    taken = 0
    why: dict[int, str] = {}
    for view in ranked:
        mesh = _mesh(view)
        # the class of a view whose truth is not known is the network's answer
        truth = tuple(answers[view.number].truth) or (str(answers[view.number].label),)
        if rules.per_mesh is not None and meshes[mesh] >= rules.per_mesh:
            why[view.number] = _more(rules, rules.per_mesh, " of its mesh")
        elif rules.per_class is not None and classes[truth] >= rules.per_class:
            why[view.number] = _more(rules, rules.per_class, " of its class")
        elif rules.most is not None and taken >= rules.most:
            why[view.number] = _more(rules, rules.most, "")
        else:
            meshes[mesh] += 1
            classes[truth] += 1
            taken += 1
    return why


def _more(rules: Selection, count: int, whose: str) -> str:
    which = "earlier" if rules.prefer == "listed" else "more confident"
    return f"there is {_a(which)} view{whose}" if count == 1 else f"there are {count} {which} views{whose}"


def _a(word: str) -> str:
    return f"an {word}" if word[0] in "aeiou" else f"a {word}"


def _mesh(view: View) -> str:
    return ",".join(thing.mesh for thing in view.probe.scene.objects)


def _confidence(answer: FirstAnswer) -> float:
    return 0.0 if answer.confidence is None else answer.confidence


def _record(view: View, answer: FirstAnswer | None, why: str, titles: Mapping[str, str]) -> ChosenView:
    return ChosenView(
        number=view.number,
        scene=scene_name({"scene": {"objects": [{"mesh": one.mesh} for one in view.probe.scene.objects]}}, titles),
        questions=[one.question for one in view.asked],
        azimuth=view.probe.scene.camera.azimuth,
        target=view.probe.target.name,
        renderer=view.image_renderer,
        label=None if answer is None else answer.label,
        confidence=None if answer is None else answer.confidence,
        truth=[] if answer is None else answer.truth,
        right=answer is not None and answer.right,
        chosen=not why,
        why=why,
    )
