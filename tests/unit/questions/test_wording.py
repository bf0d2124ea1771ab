"""Questions in words: within the language, in English, and never one text for two programs."""

import re

import pytest

from scene_attack_questions.families import FAMILIES
from scene_attack_questions.text import WORDS, encoded, tokens

pytestmark = pytest.mark.slow


def test_a_text_has_one_program(asked) -> None:
    programs: dict[str, object] = {}
    plain: dict[str, object] = {}
    for _, questions in asked:
        for question in questions:
            assert programs.setdefault(question.question, question.program) == question.program
            # Nor with synonyms and optional words taken out.
            text = " ".join(map(canonical, tokens(question.question)))
            text = re.sub(r" that (is|are)|( both| either)(?= )|( made of)(?= the same)", "", text)
            assert plain.setdefault(text, question.program) == question.program, text
    assert len(programs) > 4000


def canonical(word: str) -> str:
    names = {"big": "large", "tiny": "small", "shiny": "metal", "metallic": "metal", "matte": "rubber"}
    names |= {"block": "cube", "ball": "sphere", "object": "thing"}
    names |= {f"{name}s": f"{known}s" for name, known in names.items()}
    return names.get(word, word)


def test_every_word_is_known_and_every_known_word_is_said(asked) -> None:
    said = {WORDS[index] for _, questions in asked for question in questions for index in encoded(question.question)}
    assert said == set(WORDS)


def test_questions_are_sentences(asked) -> None:
    for _, questions in asked:
        for question in questions:
            text = question.question
            assert re.fullmatch(r"[A-Z][a-z ]+(; [a-z ]+)?\?", text), text
            assert "  " not in text
            assert not re.search(r"\ba [aeiou]|\ban [^aeiou]|\b(are|is) (are|is)\b|\b(\w+) \3\b", text), text


def test_numbers_agree(asked) -> None:
    plural = "(things|objects|cubes|blocks|spheres|balls|cylinders)"
    for _, questions in asked:
        for question in questions:
            text = question.question
            assert re.search(plural, text) or not re.search(r"\b(many|number|any|fewer|more)\b", text), text
            assert not re.search(rf"{plural} that (is|has)\b", text), text
            assert not re.search(r"\b(thing|object|cube|block|sphere|ball|cylinder) that (are|have)\b", text), text


def test_the_program_is_said_in_the_words(asked) -> None:
    """Each value and relation of a program is in the text as often as in the program."""
    for _, questions in asked:
        for question in questions:
            text = re.sub("(?i)how big", "how", question.question)
            said = [canonical(word) for word in tokens(text)]
            said = [word.removesuffix("s") if word in ("cubes", "spheres", "cylinders") else word for word in said]
            values = [value for node in question.program.nodes for value in node.values]
            for value in set(values):
                assert said.count(value) == values.count(value), question.question


def test_families_are_said_in_more_than_one_way(asked) -> None:
    starts: dict[int, set[str]] = {}
    for _, questions in asked:
        for question in questions:
            starts.setdefault(question.question_family_index, set()).add(" ".join(question.question.split()[:3]))
    assert set(starts) == set(range(len(FAMILIES)))
    assert min(map(len, starts.values())) >= 2
