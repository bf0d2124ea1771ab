"""What a person calls the scene and the attack of a job: the same words in every list and table."""

from collections.abc import Mapping
from typing import Any

from services.pipeline.extensions import RENDERERS


def scene_name(spec: Mapping[str, Any]) -> str:
    """The meshes of a full spec without their folder: "grand-piano", "couch, cube"."""
    meshes = [str(thing["mesh"]) for thing in spec["scene"]["objects"]]
    return ", ".join(mesh[:14] if mesh.startswith("sha256:") else mesh.rpartition("/")[2] for mesh in meshes)


def group_words(spec: Mapping[str, Any], group: str) -> str:
    """What pages call a parameter group of a full spec's renderer: "surface normals"."""
    renderer = RENDERERS.get(spec["attack"]["renderer"])
    return renderer.group(group).words if renderer is not None and group in renderer.group_names else group


def attack_name(spec: Mapping[str, Any]) -> str:
    """Renderer, groups and method of a full spec: "image fgsm", "torch combined fgsm", "pyrender color zoo".

    "combined" stands for all the groups of a renderer that has several; the group of a renderer with one is not named.
    A renderer that is not installed here, as of a job of another time, has its groups named.
    """
    attack = spec["attack"]
    renderer, groups, known = attack["renderer"], tuple(attack["groups"]), RENDERERS.get(attack["renderer"])
    if known is not None and set(groups) == set(known.group_names):
        groups = () if len(groups) == 1 else ("combined",)
    targeted = " targeted" if spec.get("goal", {}).get("reach") is not None else ""
    return " ".join([renderer, *(["+".join(groups)] if groups else []), attack["method"]]) + targeted
