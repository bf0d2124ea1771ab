"""Generates questions about scenes, balanced over families, functions and answers, in the form of CLEVR's files.

A family's phrases are filled in a scene by depth-first search. A choice that is ill-posed or degenerate is rejected. It
is degenerate if a part of it changes nothing: an adjective that all remaining objects have, a relation without which
the phrase stands for the same objects, or a phrase that adds nothing to another. A chain of references that comes back
to an object is degenerate too, and so is a comparison whose outcome follows from the words.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import combinations, islice
from random import Random
from typing import Annotated, Any

from pydantic import BeforeValidator, PlainSerializer, PlainValidator

from scene_attack_questions.clevr.records import ATTRIBUTES, RELATIONS, Info, Record, SceneRecord
from scene_attack_questions.executor import ANSWERS, Facts, Objects, answer, kind_of
from scene_attack_questions.families import FAMILIES, Family, Filled, Phrase
from scene_attack_questions.program import Node, Program
from scene_attack_questions.wording import word

BREADTH = 4
"""Fillings of each reference that are tried."""
DRAWS = 12
"""Combinations of adjectives tried for a phrase that stands for a set."""
ABSENT = 0.4
"""Share of these combinations, for a phrase about all objects, that ignore which objects there are."""


def instances(family: Family, facts: Facts, random: Random) -> Iterator[tuple[Filled, ...]]:
    """Yields fillings of a family's phrases in random order, depth first. Neighbours share their first choices."""
    if len(family.phrases) == 1:
        for filled in _fillings(family.phrases[0], facts, random):
            yield (filled,)
        return
    for first in islice(_fillings(family.phrases[0], facts, random), BREADTH):
        for second in _fillings(family.phrases[1], facts, random):
            if _comparable(first, second):
                yield first, second


def _comparable(first: Filled, second: Filled) -> bool:
    """Whether the outcome of a comparison of two phrases does not follow from their words."""
    if first.phrase.one:
        return first.only not in second.named_objects and second.only not in first.named_objects
    return first.members != second.members and not _follows(first, second) and not _follows(second, first)


def _follows(narrow: Filled, wide: Filled) -> bool:
    """Whether every object that `narrow` can stand for is one that `wide` can stand for."""
    return set(wide.values) <= set(narrow.values) and (
        wide.phrase.source == "scene"
        or (wide.relations, wide.named_objects) == (narrow.relations, narrow.named_objects)
    )


def _fillings(phrase: Phrase, facts: Facts, random: Random) -> Iterator[Filled]:
    for references, relations, candidates, weaker in _sources(phrase, facts, random):
        choose = _single if phrase.one else _several
        named = frozenset[int]().union(*(reference.named_objects for reference in references))
        for values, members in choose(phrase, candidates, named, weaker, facts, random):
            yield Filled(phrase, references, relations, values, members)


Found = tuple[tuple[Filled, ...], tuple[str, ...], Objects, tuple[Objects, ...]]
"""References, relations, the objects that they leave, and what each of these sets would be without one of the parts."""


def _sources(phrase: Phrase, facts: Facts, random: Random) -> Iterator[Found]:
    if phrase.source == "scene":
        yield (), (), facts.everything, ()
        return
    for first in islice(_fillings(phrase.references[0], facts, random), BREADTH):
        if phrase.source == "relate":
            for relation in random.sample(RELATIONS, 4):
                yield (first,), (relation,), facts.related[relation][first.only], (facts.everything - first.members,)
        elif phrase.source == "same":
            yield (first,), (), facts.same(phrase.shared, first.only), (facts.everything - first.members,)
        else:
            for second in islice(_fillings(phrase.references[1], facts, random), BREADTH):
                yield from _joined(phrase, first, second, facts, random)


def _joined(phrase: Phrase, first: Filled, second: Filled, facts: Facts, random: Random) -> Iterator[Found]:
    if phrase.source == "either":
        yield (first, second), (), first.members | second.members, (facts.everything, first.members, second.members)
    elif first.only != second.only:
        for relation in random.sample(RELATIONS, 4):
            for other in random.sample(RELATIONS, 4):
                first_related, second_related = facts.related[relation][first.only], facts.related[other][second.only]
                if first_related & second_related:  # or adjectives have nothing to choose among
                    yield (
                        (first, second),
                        (relation, other),
                        first_related & second_related,
                        (first_related - second.members, second_related - first.members),
                    )


Values = tuple[tuple[str, str], ...]


def _single(
    phrase: Phrase, candidates: Objects, named: Objects, weaker: Sequence[Objects], facts: Facts, random: Random
) -> Iterator[tuple[Values, Objects]]:
    """Yields a description of each candidate that has one, and that no reference names."""
    targets = list(candidates - named)
    random.shuffle(targets)
    for target in targets:
        subsets = _subsets(phrase.attributes, phrase.named)
        for attributes in random.sample(subsets, len(subsets)):
            values = tuple([(name, facts.values[name][target]) for name in attributes])
            members = _described(values, candidates, weaker, facts)
            if members is not None and len(members) == 1:
                yield values, members
                break


def _several(
    phrase: Phrase, candidates: Objects, _: Objects, weaker: Sequence[Objects], facts: Facts, random: Random
) -> Iterator[tuple[Values, Objects]]:
    """Yields sets of candidates, also empty ones, in words that mostly fit some object of the scene."""
    subsets = _subsets(phrase.attributes, phrase.named)
    absent = ABSENT if phrase.source == "scene" else 0.0
    seen = set()
    for _draw in range(DRAWS):
        # The smaller of two draws: few adjectives are more frequent than many, and so are large sets.
        attributes = subsets[int(min(random.random(), random.random()) * len(subsets))]
        if random.random() < absent:
            values = tuple(
                (name, ATTRIBUTES[name][int(random.random() * len(ATTRIBUTES[name]))]) for name in attributes
            )
        else:
            model = int(random.random() * len(facts.everything))
            values = tuple([(name, facts.values[name][model]) for name in attributes])
        if values in seen:
            continue
        seen.add(values)
        members = _described(values, candidates, weaker, facts)
        if members is not None:
            yield values, members


def _described(values: Values, candidates: Objects, weaker: Sequence[Objects], facts: Facts) -> Objects | None:
    """Returns the candidates with these values; None if a value, or what `weaker` lacks, changes nothing."""
    members = candidates
    for value in values:
        left = members & facts.having[value]
        if len(left) == len(members):
            return None
        members = left
    for others in weaker:
        for value in values:
            others = others & facts.having[value]
        if others == members:
            return None
    return members


@lru_cache
def _subsets(attributes: tuple[str, ...], named: tuple[int, int]) -> list[tuple[str, ...]]:
    least, most = named[0], min(named[1], len(attributes))
    return [chosen for count in range(least, most + 1) for chosen in combinations(attributes, count)]


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


def _answer(value: object) -> object:
    """CLEVR's generator writes truth values and numbers as such; its published files have words."""
    if isinstance(value, bool):
        value = "yes" if value else "no"
    elif isinstance(value, int):
        value = str(value)
    if isinstance(value, str) and value not in ANSWERS:
        kind_of(value)
    return value


def _program(value: object) -> Program:
    return value if isinstance(value, Program) else Program.read(value)


def _written(program: Program) -> list[dict[str, Any]]:
    return program.written()


Answer = Annotated[str, BeforeValidator(_answer)]
WrittenProgram = Annotated[Program, PlainValidator(_program), PlainSerializer(_written)]


class QuestionRecord(Record):
    """A question about an image. CLEVR's test questions have neither answer nor program nor family.

    A program that was read has the form of CLEVR's; whether it is valid is for `Program.check` to say.
    `question_family_index` is an index into `families.FAMILIES` in files made here; official files count
    CLEVR's own templates.
    """

    split: str
    image_index: int
    image_filename: str
    question: str
    question_index: int | None = None
    question_family_index: int | None = None
    answer: Answer | None = None
    program: WrittenProgram | None = None


class QuestionFile(Record):
    """A file of questions."""

    info: Info
    questions: tuple[QuestionRecord, ...]


TRIES = 8
"""Questions of a family that are drawn in a scene until one has an answer given no more often than the mean."""

_INDEX = {family: index for index, family in enumerate(FAMILIES)}


class QuestionGenerator:
    """Asks questions about one scene after another.

    The families asked least often come first: by their kind, then by what they ask, then each by itself. Of TRIES
    questions of a family, the one is taken whose answer was given least often to the same function in families of the
    same kind. The questions depend on `seed`, on `families` (those that may be asked), and on the scenes so far.
    """

    def __init__(self, seed: int, families: Sequence[Family] = FAMILIES) -> None:
        self._seed = seed
        self._families = tuple(families)
        self._asked: Counter[object] = Counter()
        self._answers: dict[tuple[str, str], Counter[str]] = {}
        self._count = 0

    def ask(self, scene: SceneRecord, count: int) -> list[QuestionRecord]:
        """Returns up to `count` different questions about a scene, of different families as long as there are some.

        There are fewer if the search finds no more that are well-posed and not degenerate.
        """
        random = Random(f"questions/{self._seed}/{scene.split}/{scene.image_index}")
        facts = Facts.of(scene)
        records: dict[Program, QuestionRecord] = {}
        before = -1
        while before < len(records) < count:
            before = len(records)
            for family in self._in_turn(random):
                question = self._question(family, facts, random)
                if question is None or question[1] in records:
                    continue
                records[question[1]] = self._record(scene, family, *question, random)
                if len(records) == count:
                    break
        return list(records.values())

    def _in_turn(self, random: Random) -> Iterator[Family]:
        """Yields each family once, each time the one that was asked least often of those that are left."""
        left = list(self._families)
        random.shuffle(left)
        while left:
            family = min(left, key=self._often)
            left.remove(family)
            yield family

    def _often(self, family: Family) -> tuple[int, int, int]:
        return self._asked[family.kind], self._asked[family.kind, family.asks], self._asked[family]

    def _question(self, family: Family, facts: Facts, random: Random) -> tuple[tuple[Filled, ...], Program, str] | None:
        answers = self._answers.setdefault((family.kind, family.asks), Counter())
        best: tuple[tuple[Filled, ...], Program, str] | None = None
        for _ in range(TRIES):
            phrases = next(instances(family, facts, random), None)
            if phrases is None:
                break
            program = build(family, phrases)
            question = phrases, program, answer(program, facts)
            if best is None or answers[question[2]] < answers[best[2]]:
                best = question
            if answers[best[2]] * len(answers) <= answers.total():
                break
        return best

    def _record(
        self,
        scene: SceneRecord,
        family: Family,
        phrases: tuple[Filled, ...],
        program: Program,
        answer_text: str,
        random: Random,
    ) -> QuestionRecord:
        self._answers[family.kind, family.asks][answer_text] += 1
        self._asked.update((family.kind, (family.kind, family.asks), family))
        self._count += 1
        return QuestionRecord(
            split=scene.split,
            image_index=scene.image_index,
            image_filename=scene.image_filename,
            question_index=self._count - 1,
            question_family_index=_INDEX[family],
            question=word(family, phrases, random),
            answer=answer_text,
            program=program,
        )
