"""Short names of a job's scene, questions, attack and parameter groups, as all lists and tables show them."""

from collections.abc import Mapping, Sequence
from typing import Any

from services.questions.program import FUNCTIONS, TYPE_WORDS
from services.rendering.declaration import RENDERERS


def scene_name(spec: Mapping[str, Any], titles: Mapping[str, str] | None = None) -> str:
    """The meshes of a full spec without their folder, e.g. "grand-piano" or "couch, cube".

    An upload is called by its name in `titles`, or by the beginning of its hash if it has none there.
    """
    return ", ".join(_mesh_name(str(thing["mesh"]), titles or {}) for thing in spec["scene"]["objects"])


def question_names(spec: Mapping[str, Any]) -> list[str]:
    """The questions of a full spec: their words, or "A program of 9 functions that asks for a number"."""
    target = spec["target"]
    asked = [*([] if target.get("question") is None else [target["question"]]), *target.get("questions", ())]
    return [question if isinstance(question, str) else _program_name(question) for question in asked]


def job_name(spec: Mapping[str, Any], titles: Mapping[str, str] | None = None) -> str:
    """The question of a full spec, "4 questions about one image", or `scene_name` if it has none."""
    questions = question_names(spec)
    if len(questions) > 1:
        return f"{len(questions)} questions about one image"
    return questions[0] if questions else scene_name(spec, titles)


def group_words(spec: Mapping[str, Any], group: str) -> str:
    """The words of pages for a parameter group of a full spec's renderer, e.g. "surface normals".

    A group that the renderer does not declare, or whose renderer is not installed, is called by its name.
    """
    renderer = RENDERERS.get(spec["attack"]["renderer"])
    return renderer.group(group).words if renderer is not None and group in renderer.group_names else group


def attack_name(spec: Mapping[str, Any]) -> str:
    """Renderer, groups and method of a full spec, e.g. "image fgsm", "torch combined fgsm" or "pyrender color zoo".

    "combined" stands for the default groups of a renderer with several of them. The only group of a renderer is not
    named. If the renderer is not installed, as an extension removed since the job ran, all its attacked groups are
    named.
    """
    attack = spec["attack"]
    renderer, groups, known = attack["renderer"], tuple(attack["groups"]), RENDERERS.get(attack["renderer"])
    if known is not None and set(groups) == set(known.default_groups):
        groups = () if len(groups) == 1 else ("combined",)
    targeted = " targeted" if spec.get("goal", {}).get("reach") is not None else ""
    return " ".join([renderer, *(["+".join(groups)] if groups else []), attack["method"]]) + targeted


def _mesh_name(mesh: str, titles: Mapping[str, str]) -> str:
    return titles.get(mesh, mesh[:14]) if mesh.startswith("sha256:") else mesh.rpartition("/")[2]


def _program_name(calls: Sequence[Mapping[str, Any]]) -> str:
    functions = "1 function" if len(calls) == 1 else f"{len(calls)} functions"
    return f"A program of {functions} that asks for {TYPE_WORDS[FUNCTIONS[calls[-1]['function']].output]}"
