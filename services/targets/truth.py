"""The labels of a network that are right for a mesh of the library, and the labels of ImageNet that mean the same.

`imagenet_truth.json` was reviewed by hand, model by model: the ImageNet labels that a person would accept for a kind
of furniture ("kinds") or, where the kind is too coarse, for one mesh ("meshes", which goes before its kind). A model in
doubt has none. "same" lists the groups of ImageNet labels between which no picture decides.
"""

import json
from functools import cache
from importlib.resources import files
from typing import TypedDict

from services.scenes.furniture_kinds import PREFIX, kind_of
from services.targets.info import TargetInfo


class Table(TypedDict):
    """The content of imagenet_truth.json. Meshes are named without the prefix "furniture/"."""

    kinds: dict[str, list[str]]
    meshes: dict[str, list[str]]
    same: list[list[str]]


@cache
def imagenet_table() -> Table:
    """Returns the reviewed table for ImageNet's labels."""
    table: Table = json.loads(files("services.targets").joinpath("imagenet_truth.json").read_text("utf-8"))
    return table


def truth_labels(target: TargetInfo, mesh: str) -> tuple[str, ...]:
    """Returns the target's labels that are right for a mesh ("furniture/couch"); empty if nobody has said them.

    For a vocabulary of kinds it is the mesh's kind, which need not be among the target's labels.
    """
    if target.vocabulary in ("clevr", "custom") or not mesh.startswith(PREFIX):
        return ()
    kind = kind_of(mesh)
    if target.vocabulary != "imagenet":
        return () if kind is None else (kind,)
    table = imagenet_table()
    named = table["meshes"].get(mesh.removeprefix(PREFIX))
    return tuple(table["kinds"].get(kind or "", []) if named is None else named)


def same_labels(target: TargetInfo) -> tuple[frozenset[str], ...]:
    """Returns the groups of the target's labels that mean the same thing ("sunglass" and "sunglasses")."""
    if target.vocabulary != "imagenet":
        return ()
    return tuple(frozenset(group) for group in imagenet_table()["same"])
