"""The page of models that other people made says what the committed result says."""

from benchmarks.own_meshes import MODELS
from benchmarks.own_meshes_page import PAGE, REASONS, page


def test_the_table_is_written_from_the_result() -> None:
    assert PAGE.read_text("utf-8") == page(), "write it again with: python -m benchmarks.own_meshes"


def test_every_model_has_a_row_and_every_reason_a_model() -> None:
    rows = [line.split("|")[1].strip(" `") for line in PAGE.read_text("utf-8").splitlines() if line.startswith("| `")]
    names = [name.rpartition("/")[2] for name in MODELS]
    assert rows == names
    assert set(REASONS) <= set(names)
    assert len(names) == 16
    assert len({name.rpartition(".")[2].lower() for name in names}) >= 7
