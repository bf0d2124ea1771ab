"""Words a family's filled phrases as a question in CLEVR's language."""

import re
from collections.abc import Callable, Sequence
from random import Random

from services.questions.templates import forms
from services.questions.templates.families import Family
from services.questions.templates.phrases import Filled

_SLOT = re.compile(r"\{([^}]*)\}")
_OPTIONAL = re.compile(r"\[([^]]*)\] ?")


def word(family: Family, phrases: Sequence[Filled], random: Random) -> str:
    """Returns a question of a family about filled phrases, with a form and synonyms drawn at random."""
    text = _Wording(phrases, random).say(_forms(family), family.attribute)
    return text[0].upper() + text[1:] + "?"


def _forms(family: Family) -> Sequence[str]:
    source = family.phrases[0].source
    if family.kind == "compare_integer":
        return forms.INTEGERS[family.asks]
    if family.kind == "comparison":
        return forms.MADE_OF if family.attribute == "material" else forms.EQUAL
    if family.asks == "count":
        return forms.COUNT[source]
    return forms.EXIST[source] if family.asks == "exist" else forms.QUERY[family.attribute]


class _Wording:
    def __init__(self, phrases: Sequence[Filled], random: Random) -> None:
        self._phrases = dict(zip("ab", phrases, strict=False))
        self._random = random

    def say(self, choices: Sequence[str], attribute: str) -> str:
        return self._filled(choices, lambda slot: attribute if slot == "attribute" else self._slot(slot))

    def _filled(self, choices: Sequence[str], fill: Callable[[str], str]) -> str:
        form = self._random.choice(choices)
        form = _OPTIONAL.sub(lambda found: f"{found[1]} " if self._random.random() < 0.5 else "", form)
        return _SLOT.sub(lambda found: fill(found[1]), form)

    def _slot(self, slot: str) -> str:
        first = self._phrases["a"]
        it = slot.endswith(" it")
        match slot.removesuffix(" it").split():
            case ["how", "many"]:
                return self._random.choice(forms.HOW_MANY)
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
        names = [*(forms.SYNONYMS.get(value, (value,)) for value in values.values())]
        names.append(forms.THINGS if shape is None else forms.SYNONYMS.get(shape, (shape,)))
        return " ".join(self._random.choice(name) for name in names) + ("s" if plural else "")

    def _tail(self, phrase: Filled, plural: bool, it: bool) -> str:
        """What follows the noun, with the blank before it: " that are left of the ball"."""
        if phrase.phrase.source == "scene":
            return ""
        where = self._where(phrase, plural, it)
        if phrase.phrase.source == "same":
            return f" that {where}"
        be = "are" if plural else "is"
        left_out = phrase.phrase.source == "relate" and self._random.random() < 0.5
        return f" {where}" if left_out else f" that {be} {where}"

    def _where(self, phrase: Filled, plural: bool, it: bool) -> str:
        """What is said of the objects of a phrase: "left of the ball", "have the same color as it"."""
        references = phrase.references
        match phrase.phrase.source:
            case "relate":
                return f"{self._relation(phrase.relations[0])} {'it' if it else self._the(references[0])}"
            case "same":
                shared = phrase.phrase.shared
                known = forms.SHARING_MATERIAL if shared == "material" else forms.SHARING
                reference = "it" if it else self._the(references[0])
                return self._filled(known[plural], lambda slot: shared if slot == "attribute" else reference)
            case "both":
                both = self._random.choice(("both ", ""))
                pairs = zip(phrase.relations, references, strict=True)
                return both + " and ".join(f"{self._relation(name)} {self._the(one)}" for name, one in pairs)
            case "either":
                return " or ".join(
                    f"{self._noun(one, plural=True)}{self._tail(one, True, False)}" for one in references
                )
        raise AssertionError(phrase.phrase.source)

    def _relation(self, name: str) -> str:
        return self._random.choice(forms.RELATIONS[name])
