"""Scenes and the questions about them that several tests look at."""

import pytest

from services.questions.generator import QuestionGenerator, QuestionRecord
from services.scenes.clevr.generator import generate
from services.scenes.clevr.records import SceneRecord


@pytest.fixture(scope="session")
def asked() -> list[tuple[SceneRecord, list[QuestionRecord]]]:
    """430 scenes with twelve questions each."""
    generator = QuestionGenerator(3)
    scenes = [generate(3, k, split="test") for k in range(430)]
    return [(scene, generator.ask(scene, 12)) for scene in scenes]
