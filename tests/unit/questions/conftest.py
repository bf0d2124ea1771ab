"""Scenes and the questions about them that several tests look at."""

import pytest

from scene_attack_questions.clevr.generator import generate
from scene_attack_questions.clevr.records import SceneRecord
from scene_attack_questions.generator import QuestionGenerator, QuestionRecord


@pytest.fixture(scope="session")
def asked() -> list[tuple[SceneRecord, list[QuestionRecord]]]:
    """430 scenes with twelve questions each."""
    generator = QuestionGenerator(3)
    scenes = [generate(3, k, split="test") for k in range(430)]
    return [(scene, generator.ask(scene, 12)) for scene in scenes]
