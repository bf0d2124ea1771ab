"""The 90 families of questions, as in CLEVR: which phrases a question has, and what it asks of them.

A phrase is what a question says of a set of objects, before values and relations are chosen, and after.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

from scene_attack_questions.executor import Objects
from scene_attack_questions.program import ATTRIBUTE_TYPES

Source = Literal["scene", "relate", "same", "both", "either"]
"""Source of the objects of a phrase, before its adjectives and its noun choose among them.

scene: all objects; relate: those in a relation to the reference; same: those that share an attribute with it; both:
those in one relation to the first reference and in one to the second; either: those of two other phrases.
"""


@dataclass(frozen=True)
class Phrase:
    """A phrase of a template: "the [size] [color] [material] [shape] that is [relation] …".

    `references` are the phrases that its source takes; `shared` is the attribute of "same". `one` says that it stands
    for the only object there is. It names `named[0]` to `named[1]` attributes, all of them in `attributes`.
    """

    source: Source = "scene"
    references: tuple["Phrase", ...] = ()
    shared: str = ""
    one: bool = False
    attributes: tuple[str, ...] = ATTRIBUTE_TYPES
    named: tuple[int, int] = (0, 4)


@dataclass(frozen=True)
class Filled:
    """A phrase with its choices in a scene.

    `values` are the named attributes with their values, in the order of ATTRIBUTES; `relations` has one relation for
    each reference of "relate" and "both"; `members` are the objects that the phrase stands for.
    """

    phrase: Phrase
    references: tuple["Filled", ...]
    relations: tuple[str, ...]
    values: tuple[tuple[str, str], ...]
    members: Objects

    @property
    def only(self) -> int:
        """The object of a phrase that stands for one."""
        (k,) = self.members
        return k

    @cached_property
    def named_objects(self) -> Objects:
        """The objects that the phrase, or a reference in it, names as the only one."""
        mine = self.members if self.phrase.one else frozenset()
        return mine.union(*(reference.named_objects for reference in self.references))


Kind = Literal[
    "zero_hop",
    "one_hop",
    "two_hop",
    "three_hop",
    "same_relate",
    "single_and",
    "single_or",
    "compare_integer",
    "comparison",
]
"""The nine kinds of families, named after CLEVR's files of templates."""


@dataclass(frozen=True, eq=False)
class Family:
    """A template of questions: its kind, the last function of its programs, and one or two phrases."""

    kind: Kind
    asks: str
    phrases: tuple[Phrase, ...]

    @property
    def attribute(self) -> str:
        """The attribute that a query or a comparison of attributes is about; "" or another word otherwise."""
        return self.asks.partition("_")[2]


def _related(reference: Phrase) -> Phrase:
    return Phrase("relate", (reference,))


def _the(phrase: Phrase, *unnamed: str) -> Phrase:
    """The phrase for a single object, whose attributes `unnamed` it does not name."""
    return replace(phrase, one=True, attributes=_without(*unnamed))


def _without(*unnamed: str) -> tuple[str, ...]:
    return tuple(attribute for attribute in ATTRIBUTE_TYPES if attribute not in unnamed)


ANY = Phrase()
SOME = Phrase(named=(1, 4))
THE = _the(ANY)


def _hops() -> Iterator[Family]:
    phrase = ANY
    kinds: tuple[Kind, ...] = ("zero_hop", "one_hop", "two_hop", "three_hop")
    for kind in kinds:
        yield Family(kind, "count", (phrase,))
        yield Family(kind, "exist", (SOME if phrase is ANY else phrase,))
        for attribute in ATTRIBUTE_TYPES:
            yield Family(kind, f"query_{attribute}", (_the(phrase, attribute),))
        phrase = _related(_the(phrase))


def _same() -> Iterator[Family]:
    for shared in ATTRIBUTE_TYPES:
        others = Phrase("same", (_the(ANY, shared),), shared=shared)
        for named in ((0, 0), (1, 3)):
            phrase = replace(others, attributes=_without(shared), named=named)
            yield Family("same_relate", "exist", (phrase,))
            yield Family("same_relate", "count", (phrase,))
        for attribute in _without(shared):
            yield Family("same_relate", f"query_{attribute}", (_the(others, shared, attribute),))


def _and() -> Iterator[Family]:
    phrase = Phrase("both", (THE, THE))
    yield Family("single_and", "count", (phrase,))
    for attribute in ATTRIBUTE_TYPES:
        yield Family("single_and", f"query_{attribute}", (_the(phrase, attribute),))


def _or() -> Iterator[Family]:
    def either(first: Phrase, second: Phrase) -> Phrase:
        return Phrase("either", (first, second), named=(0, 0))

    yield Family("single_or", "count", (either(SOME, SOME),))
    for attribute in ATTRIBUTE_TYPES:
        part = replace(SOME, attributes=_without(attribute))
        phrase = replace(either(part, part), attributes=(attribute,), named=(1, 1))
        yield Family("single_or", "count", (phrase,))
    near = _related(THE)
    for parts in ((near, near), (near, SOME), (SOME, near)):
        yield Family("single_or", "count", (either(*parts),))


def _integers() -> Iterator[Family]:
    near = _related(THE)
    for phrases in ((ANY, ANY), (near, ANY), (near, near)):
        for asks in ("equal_integer", "less_than", "greater_than"):
            yield Family("compare_integer", asks, phrases)


def _attributes() -> Iterator[Family]:
    for attribute in ATTRIBUTE_TYPES:
        plain, near = _the(ANY, attribute), _the(_related(THE), attribute)
        for phrases in ((plain, plain), (near, plain), (plain, near), (near, near)):
            yield Family("comparison", f"equal_{attribute}", phrases)


FAMILIES: tuple[Family, ...] = (*_hops(), *_same(), *_and(), *_or(), *_integers(), *_attributes())
"""All families; a question's `question_family_index` is an index into them."""
