"""The page of glTF materials says what the committed result says."""

from benchmarks.gltf_models import MODELS
from benchmarks.gltf_page import PAGE, REASONS, page


def test_the_table_is_written_from_the_result() -> None:
    assert PAGE.read_text("utf-8") == page(), "write it again with: python -m benchmarks.gltf_materials"


def test_every_model_has_a_row_and_every_reason_a_model() -> None:
    rows = [line.split("|")[1].strip() for line in PAGE.read_text("utf-8").splitlines() if line.startswith("| ")]
    assert set(MODELS) <= set(rows)
    assert set(REASONS) <= set(MODELS)
