"""The labels of targets: lists and checks them without loading the network, and finds those that are right for a mesh.

`imagenet_truth.json` was reviewed by hand, model by model: the ImageNet labels that a person would accept for a kind of
furniture ("kinds") or, where the kind is too coarse, for one mesh ("meshes", which goes before its kind). A model in
doubt has none. "same" lists the groups of ImageNet labels between which no image decides. It needs no torch, unless a
plug-in does.
"""

import json
from collections import Counter
from functools import cache, lru_cache
from importlib.resources import files
from typing import TypedDict

from scene_attack.errors import InvalidRequest, JobFailure, out_of_memory, printable, summary
from scene_attack.scenes.furniture import PREFIX, kind_of
from scene_attack.targets.info import LONGEST_LABEL, TargetInfo, known


@lru_cache(maxsize=1)
def imagenet_labels() -> tuple[str, ...]:
    """Returns the label names: the first WordNet lemma of each synset, made unique where two synsets share it."""
    lines = files("scene_attack.targets").joinpath("imagenet.tsv").read_text("utf-8").splitlines()
    return tuple(line.split("\t")[1] for line in lines)


_SHOWN = 400
"""Characters of a target's own error that a message shows; torch lists every weight that is missing."""


def labels(name: str) -> tuple[str, ...]:
    """Returns the labels of a target without loading it.

    Raises InvalidRequest("target.name") for an unknown target, and for labels that cannot be listed, are no text that
    can be printed, or are not unique.
    """
    target = known(name)
    try:
        names = tuple(target.labels())
    except (Exception, SystemExit) as error:
        raise refused(name, f"cannot list its labels: {in_words(name, error)}") from error
    for label in names:
        if not isinstance(label, str) or not label or printable(label) != label:
            raise refused(name, f"has the label {label!r:.80}, which is no text to be shown")
        if len(label) > LONGEST_LABEL:
            raise refused(name, f"has the label {label!r:.80}… of {len(label):,} characters; {LONGEST_LABEL} are most")
    for label, times in Counter(names).items():
        if times > 1:
            raise refused(name, f"has the label {label!r} more than once; labels are unique")
    return names


def in_words(name: str, error: BaseException) -> str:
    """Returns the error in words. Raises JobFailure("out-of-memory") if memory has run out: other jobs may have taken
    it.
    """
    if isinstance(error, InvalidRequest):
        raise error
    if out_of_memory(error):
        raise JobFailure("out-of-memory", f"target {name!r} needs more memory than is left") from error
    words = summary(error)
    return words if len(words) <= _SHOWN else f"{words[:_SHOWN]}…"


def refused(name: str, why: str) -> InvalidRequest:
    """Returns the error of a target that cannot be used."""
    return InvalidRequest("target.name", f"target {name!r} {why}")


class Table(TypedDict):
    """The content of imagenet_truth.json. Meshes are named without the prefix "furniture/"."""

    kinds: dict[str, list[str]]
    meshes: dict[str, list[str]]
    same: list[list[str]]


@cache
def imagenet_table() -> Table:
    """Returns the reviewed table for ImageNet's labels."""
    table: Table = json.loads(files("scene_attack.targets").joinpath("imagenet_truth.json").read_text("utf-8"))
    return table


def truth_labels(target: TargetInfo, mesh: str) -> tuple[str, ...]:
    """Returns the target's labels that are right for a mesh ("furniture/couch"); empty if none have been reviewed.

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
