"""An attack on the answer of the converted network, from a question in words to the result."""

from pathlib import Path

import torch
from PIL import Image

from services.pipeline.execute import execute
from services.pipeline.spec import parse
from services.scenes.clevr.description import describe
from services.scenes.clevr.generator import generate
from services.targets.iep.prefix import to_prefix
from services.targets.iep_released.target import ReleasedIepTarget
from tests.unit.jobs.small import LIBRARY
from tests.unit.targets.iep_released import published

RECORD = generate(8, 2, objects=(4, 4))
SCENE = describe(RECORD, (60, 80)).model_copy(update={"shadows": None})
"""Small and without shadows, so that it is drawn at once."""


def test_a_question_in_words_is_attacked_through_the_image(target: ReleasedIepTarget, tmp_path: Path) -> None:
    words, program = next(iter(published.QUESTIONS.items()))
    data = {
        "record": RECORD.model_dump(mode="json"),
        "scene": SCENE.model_dump(mode="json"),
        "target": {"name": "released", "question": words},
        "attack": {"renderer": "image", "base_renderer": "pyrender", "method": "fgsm", "steps": 2},
    }
    result = execute(parse(data), tmp_path, LIBRARY)
    [found] = result.questions
    assert found.program == target.program(words).written()
    assert tuple(to_prefix(target.program(words))) == program
    assert found.right == str(sum(one.shape == "cube" for one in RECORD.objects))
    assert result.provenance.weights_sha256 == target.weights_sha256
    with Image.open(tmp_path / "attacked.png") as image:
        pixels = torch.frombuffer(bytearray(image.tobytes()), dtype=torch.uint8).view(1, 60, 80, 3) / 255
    assert target.labels[int(target.logits(pixels, words)[0].argmax())] == found.after.label
    attended = target.attention(pixels, words)
    assert [one.node for one in found.attention] == [0, 1]
    for one in found.attention:
        expected = attended[one.node]
        assert expected is not None
        with Image.open(tmp_path / one.after) as image:
            assert image.size == (16 * 14, 16 * 14)
            assert image.getpixel((16 * 3 + 5, 16 * 2 + 5)) == (round(255 * float(expected[0, 2, 3])),) * 3
