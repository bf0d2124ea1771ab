"""What a person calls the scene and the attack of a job: the same words in every list and table."""

from collections.abc import Mapping
from typing import Any

from services.attacks.spec import RENDERER_GROUPS


def scene_name(spec: Mapping[str, Any]) -> str:
    """The meshes of a full spec without their folder: "grand-piano", "couch, cube"."""
    meshes = [str(thing["mesh"]) for thing in spec["scene"]["objects"]]
    return ", ".join(mesh[:14] if mesh.startswith("sha256:") else mesh.rpartition("/")[2] for mesh in meshes)


def attack_name(spec: Mapping[str, Any]) -> str:
    """Renderer, groups and method of a full spec: "image fgsm", "torch combined fgsm", "pyrender color zoo".

    "combined" stands for all the groups of a renderer that has several.
    """
    attack = spec["attack"]
    renderer, groups, everything = attack["renderer"], tuple(attack["groups"]), RENDERER_GROUPS[attack["renderer"]]
    if renderer == "image":
        groups = ()
    elif set(groups) == set(everything):
        groups = ("combined",)
    targeted = " targeted" if spec.get("goal", {}).get("reach") is not None else ""
    return " ".join([renderer, *(["+".join(groups)] if groups else []), attack["method"]]) + targeted
