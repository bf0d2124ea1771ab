"""Builds the program of a family's filled phrases."""

from collections.abc import Sequence

from services.questions.program import Node, Program
from services.questions.templates.families import Family
from services.questions.templates.phrases import Filled


def build(family: Family, phrases: Sequence[Filled]) -> Program:
    """Returns the program that asks a family's question of filled phrases."""
    nodes: list[Node] = []
    if family.kind == "compare_integer":
        inputs = [_call(nodes, "count", _phrase(nodes, phrase)) for phrase in phrases]
    elif family.kind == "comparison":
        inputs = [_call(nodes, f"query_{family.attribute}", _phrase(nodes, phrase)) for phrase in phrases]
    else:
        inputs = [_phrase(nodes, phrase) for phrase in phrases]
    _call(nodes, family.asks, *inputs)
    return Program(tuple(nodes))


def _phrase(nodes: list[Node], filled: Filled) -> int:
    """Adds the nodes of a phrase. Returns the index of the last, which gives its set, or its object if it is one."""
    source, relations = filled.phrase.source, filled.relations
    if source == "scene":
        last = _call(nodes, "scene")
    elif source == "same":
        last = _call(nodes, f"same_{filled.phrase.shared}", _phrase(nodes, filled.references[0]))
    elif source == "either":
        last = _call(nodes, "union", *[_phrase(nodes, reference) for reference in filled.references])
    else:
        related = [
            _call(nodes, "relate", _phrase(nodes, reference), value=relation)
            for reference, relation in zip(filled.references, relations, strict=True)
        ]
        last = related[0] if source == "relate" else _call(nodes, "intersect", *related)
    for attribute, value in filled.values:
        last = _call(nodes, f"filter_{attribute}", last, value=value)
    return _call(nodes, "unique", last) if filled.phrase.one else last


def _call(nodes: list[Node], function: str, *inputs: int, value: str | None = None) -> int:
    nodes.append(Node(function, inputs, () if value is None else (value,)))
    return len(nodes) - 1
