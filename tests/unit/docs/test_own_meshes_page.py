"""The page of models that other people made says what the committed result says, and gives the reasons."""

import json

from benchmarks.own_meshes import MODELS
from benchmarks.own_meshes_page import PAGE, REASONS, page
from benchmarks.report import RESULTS

NAMES = [name.rpartition("/")[2] for name in MODELS]


def test_the_tables_are_written_from_the_result() -> None:
    assert PAGE.read_text("utf-8") == page(), "write it again with: python -m benchmarks.own_meshes"


def test_every_model_has_a_row_of_figures_and_one_of_words_and_every_reason_a_model() -> None:
    rows = [line.split("|")[1].strip(" `") for line in PAGE.read_text("utf-8").splitlines() if line.startswith("| `")]
    assert rows == NAMES + NAMES
    assert set(REASONS) <= set(NAMES)
    assert len(NAMES) == 16
    assert len({name.rpartition(".")[2].lower() for name in NAMES}) >= 7


def test_every_difference_has_a_reason_that_makes_it_vanish() -> None:
    """Done alike, the images agree."""
    result = json.loads((RESULTS / "own_meshes.json").read_text("utf-8"))
    for row in result["rows"]:
        assert row["mean"] < result["limit"] or REASONS[row["model"]]
        assert max(row["alike"]["mean"], row["alike_fine"]["mean"]) < 1.2, row["model"]


def test_what_is_ours_to_lose_is_in_the_notes() -> None:
    result = json.loads((RESULTS / "own_meshes.json").read_text("utf-8"))
    notes = {row["model"]: " ".join(row["notes"]) for row in result["rows"]}
    for model in ("capsule.obj", "CesiumMilkTruck.glb", "AlphaBlendModeTest.glb"):
        assert "texels, of which at most 1024 a side are shown" in notes[model]
    assert "blends of vertex colours" in notes["reference.ply"]
    assert "partial opacity of colours" in notes["reference.ply"]
    assert "KHR_materials_clearcoat" in notes["ClearCoatTest.gltf"]
