"""Phrases: what a question says of a set of objects, before and after values and relations are chosen."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from services.questions.facts import Objects
from services.questions.functions import ATTRIBUTE_TYPES

Source = Literal["scene", "relate", "same", "both", "either"]
"""Where the objects of a phrase come from, before its adjectives and its noun choose among them.

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
