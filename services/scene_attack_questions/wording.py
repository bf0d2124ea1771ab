"""Words a family's filled phrases as a question in CLEVR's language, by its forms, synonyms and names of relations.

In a form, {…} is a slot that is filled here, […] is said every other time, and a question begins with a capital and
ends with a question mark. `a` and `b` are the phrases of a family: "{the a}" is "the large ball behind the red cube",
"{an a}" is "a large ball …", "{all a}" is "large balls …". "{intro}" introduces the reference of phrase `a` ("a red
cube"), to which "it" refers where a slot ends in "it". "{nouns}" is phrase `a` up to its noun, and "{where}" is what
follows the noun.
"""

import re
from collections.abc import Callable, Sequence
from random import Random

from scene_attack_questions.families import Family, Filled

THINGS = ("thing", "object")
SYNONYMS = {
    "large": ("large", "big"),
    "small": ("small", "tiny"),
    "metal": ("metal", "metallic", "shiny"),
    "rubber": ("rubber", "matte"),
    "cube": ("cube", "block"),
    "sphere": ("sphere", "ball"),
}
"""Names of the values that have more than one."""

RELATIONS = {
    "left": ("left of", "to the left of", "on the left side of"),
    "right": ("right of", "to the right of", "on the right side of"),
    "front": ("in front of",),
    "behind": ("behind",),
}

HOW_MANY = ("how many", "what number of")

COUNT = {
    "scene": ("{how many} {nouns} are there",),
    "relate": ("{how many} {nouns} are {where}", "there is {intro}; {how many} {nouns} are {where it}"),
    "same": ("{how many} other {nouns} {where}", "there is {intro}; {how many} other {nouns} {where it}"),
    "both": ("{how many} {nouns} are {where}",),
    "either": ("{how many} {nouns} are [either] {where}",),
}
"""Forms that ask for a number, by the source of the phrase."""

EXIST = {
    "scene": ("are there any {all a}", "is there {an a}", "are any {all a} visible"),
    "relate": (
        "are there any {all a}",
        "is there {an a}",
        "there is {intro}; are there any {all a it}",
        "there is {intro}; is there {an a it}",
    ),
    "same": (
        "are there any {all a}",
        "is there {an a}",
        "there is {intro}; are there any {all a it}",
        "there is {intro}; is there {an a it}",
    ),
}
"""Forms that ask whether there is an object, by the source of the phrase."""

QUERY = {
    "size": (
        "what size is {the a}",
        "what is the size of {the a}",
        "how big is {the a}",
        "{the a} has what size",
        "{the a} is what size",
        "there is {an a}; what size is it",
        "there is {an a}; what is its size",
        "there is {an a}; how big is it",
    ),
    "color": (
        "what color is {the a}",
        "what is the color of {the a}",
        "{the a} has what color",
        "{the a} is what color",
        "there is {an a}; what color is it",
        "there is {an a}; what is its color",
    ),
    "material": (
        "what material is {the a}",
        "what is the material of {the a}",
        "what is {the a} made of",
        "what [material] is {the a} made of",
        "{the a} is made of what material",
        "there is {an a}; what is it made of",
        "there is {an a}; what material is it made of",
        "there is {an a}; what is its material",
    ),
    "shape": (
        "what shape is {the a}",
        "what is the shape of {the a}",
        "{the a} has what shape",
        "{the a} is what shape",
        "there is {an a}; what shape is it",
        "there is {an a}; what is its shape",
    ),
}
"""Forms that ask for an attribute of an object, by attribute."""

EQUAL = (
    "do {the a} and {the b} have the same {attribute}",
    "does {the a} have the same {attribute} as {the b}",
    "is {the a} the same {attribute} as {the b}",
    "is the {attribute} of {the a} the same as {the b}",
    "there is {an a}; does it have the same {attribute} as {the b}",
    "there is {an a}; is it the same {attribute} as {the b}",
    "there is {an a}; is its {attribute} the same as {the b}",
)
"""Forms that compare two objects. "is … the same material as" is no English: `MADE_OF` says it."""
MADE_OF = (
    "do {the a} and {the b} have the same material",
    "does {the a} have the same material as {the b}",
    "are {the a} and {the b} made of the same material",
    "is {the a} made of the same material as {the b}",
    "is the material of {the a} the same as {the b}",
    "there is {an a}; does it have the same material as {the b}",
    "there is {an a}; is it made of the same material as {the b}",
    "there is {an a}; is its material the same as {the b}",
)

INTEGERS = {
    "equal_integer": (
        "are there an equal number of {all a} and {all b}",
        "are there the same number of {all a} and {all b}",
        "is the number of {all a} the same as the number of {all b}",
    ),
    "less_than": (
        "are there fewer {all a} than {all b}",
        "is the number of {all a} less than the number of {all b}",
    ),
    "greater_than": (
        "are there more {all a} than {all b}",
        "is the number of {all a} greater than the number of {all b}",
    ),
}
"""Forms that compare two numbers."""

SHARING = {
    True: ("have the same {attribute} as {reference}", "are the same {attribute} as {reference}"),
    False: ("has the same {attribute} as {reference}", "is the same {attribute} as {reference}"),
}
"""Forms that say what several objects (True) or one object (False) share with a reference."""
SHARING_MATERIAL = {
    True: ("have the same material as {reference}", "are [made of] the same material as {reference}"),
    False: ("has the same material as {reference}", "is [made of] the same material as {reference}"),
}


_SLOT = re.compile(r"\{([^}]*)\}")
_OPTIONAL = re.compile(r"\[([^]]*)\] ?")


def word(family: Family, phrases: Sequence[Filled], random: Random) -> str:
    """Returns a question of a family about filled phrases, with a form and synonyms drawn at random."""
    text = _Wording(phrases, random).say(_forms(family), family.attribute)
    return text[0].upper() + text[1:] + "?"


def _forms(family: Family) -> Sequence[str]:
    source = family.phrases[0].source
    if family.kind == "compare_integer":
        return INTEGERS[family.asks]
    if family.kind == "comparison":
        return MADE_OF if family.attribute == "material" else EQUAL
    if family.asks == "count":
        return COUNT[source]
    return EXIST[source] if family.asks == "exist" else QUERY[family.attribute]


class _Wording:
    def __init__(self, phrases: Sequence[Filled], random: Random) -> None:
        self._phrases = dict(zip("ab", phrases, strict=False))
        self._random = random

    def say(self, choices: Sequence[str], attribute: str) -> str:
        return self._filled(choices, lambda slot: attribute if slot == "attribute" else self._slot(slot))

    def _filled(self, choices: Sequence[str], fill: Callable[[str], str]) -> str:
        form = self._random.choice(choices)
        form = _OPTIONAL.sub(lambda match: f"{match[1]} " if self._random.random() < 0.5 else "", form)
        return _SLOT.sub(lambda match: fill(match[1]), form)

    def _slot(self, slot: str) -> str:
        first = self._phrases["a"]
        it = slot.endswith(" it")
        match slot.removesuffix(" it").split():
            case ["how", "many"]:
                return self._random.choice(HOW_MANY)
            case ["intro"]:
                return self._an(first.references[0], False)
            case ["nouns"]:
                return self._noun(first, plural=True)
            case ["where"]:
                return self._where(first, True, it)
            case ["the", name]:
                return self._the(self._phrases[name])
            case ["an", name]:
                return self._an(self._phrases[name], it)
            case ["all", name]:
                phrase = self._phrases[name]
                other = "other " if phrase.phrase.source == "same" else ""
                return f"{other}{self._noun(phrase, plural=True)}{self._tail(phrase, True, it)}"
        raise AssertionError(slot)

    def _the(self, phrase: Filled) -> str:
        other = "other " if phrase.phrase.source == "same" else ""
        return f"the {other}{self._noun(phrase, plural=False)}{self._tail(phrase, False, False)}"

    def _an(self, phrase: Filled, it: bool) -> str:
        noun, tail = self._noun(phrase, plural=False), self._tail(phrase, False, it)
        if phrase.phrase.source == "same":
            # With nothing to say of it, "anything else" is the same as "another thing".
            bare = not phrase.values and self._random.random() < 0.5
            return f"anything else{tail}" if bare and not phrase.phrase.one else f"another {noun}{tail}"
        return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}{tail}"

    def _noun(self, phrase: Filled, plural: bool) -> str:
        values = dict(phrase.values)
        shape = values.pop("shape", None)
        names = [*(SYNONYMS.get(value, (value,)) for value in values.values())]
        names.append(THINGS if shape is None else SYNONYMS.get(shape, (shape,)))
        return " ".join(self._random.choice(name) for name in names) + ("s" if plural else "")

    def _tail(self, phrase: Filled, plural: bool, it: bool) -> str:
        """The words that follow the noun, with the blank before them: " that are left of the ball"."""
        if phrase.phrase.source == "scene":
            return ""
        where = self._where(phrase, plural, it)
        if phrase.phrase.source == "same":
            return f" that {where}"
        be = "are" if plural else "is"
        left_out = phrase.phrase.source == "relate" and self._random.random() < 0.5
        return f" {where}" if left_out else f" that {be} {where}"

    def _where(self, phrase: Filled, plural: bool, it: bool) -> str:
        """The predicate about the objects of a phrase: "left of the ball", "have the same color as it"."""
        references = phrase.references
        match phrase.phrase.source:
            case "relate":
                return f"{self._relation(phrase.relations[0])} {'it' if it else self._the(references[0])}"
            case "same":
                shared = phrase.phrase.shared
                known = SHARING_MATERIAL if shared == "material" else SHARING
                reference = "it" if it else self._the(references[0])
                return self._filled(known[plural], lambda slot: shared if slot == "attribute" else reference)
            case "both":
                both = self._random.choice(("both ", ""))
                pairs = zip(phrase.relations, references, strict=True)
                return both + " and ".join(
                    f"{self._relation(name)} {self._the(reference)}" for name, reference in pairs
                )
            case "either":
                return " or ".join(
                    f"{self._noun(reference, plural=True)}{self._tail(reference, True, False)}"
                    for reference in references
                )
        raise AssertionError(phrase.phrase.source)

    def _relation(self, name: str) -> str:
        return self._random.choice(RELATIONS[name])
