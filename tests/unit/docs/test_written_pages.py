"""Pages that commands write are as the commands write them: from the results that are committed, and from the code."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks import gltf_materials
from benchmarks import page as benchmarks_page
from benchmarks.study.pages import FOLDER, PAGES
from scene_attack.cli import commands_page
from scene_attack.runs import field_tables
from scene_attack_accuracy import work_precision
from scene_attack_accuracy.stability import report as stability
from scene_attack_api import openapi

DOCS = Path(__file__).parents[3] / "docs"
ACCURACY = DOCS / "accuracy"


def work_precision_page() -> str:
    report = (ACCURACY / "work-precision.json").read_text("utf-8")
    return work_precision.markdown(work_precision.Report.model_validate_json(report))


def stability_page() -> str:
    return stability.markdown(stability.Report.model_validate_json((ACCURACY / "stability.json").read_text("utf-8")))


WRITTEN: dict[str, tuple[str, Callable[[], str]]] = {
    "reports/benchmarks.md": ("python -m benchmarks.page", benchmarks_page.page),
    "reports/gltf.md": ("python -m benchmarks.gltf_materials", gltf_materials.page),
    "reference/commands.md": (
        "python -m scene_attack.cli.commands_page > docs/reference/commands.md",
        commands_page.page,
    ),
    "reference/fields.md": ("python -m scene_attack.runs.field_tables", field_tables.page),
    "reference/api.md": ("python -m scene_attack_api.openapi page > docs/reference/api.md", openapi.page),
    "accuracy/stability.md": ("scene-attack accuracy stability", stability_page),
    "accuracy/work-precision.md": ("scene-attack accuracy work-precision", work_precision_page),
}
"""Each file with the command that writes it."""


@pytest.mark.parametrize("name", WRITTEN)
def test_a_page_is_as_its_command_writes_it(name: str) -> None:
    command, write = WRITTEN[name]
    assert (DOCS / name).read_text("utf-8") == write(), f"write it again with: {command}"


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_studys_pages_and_curves_are_written_from_their_records(page) -> None:
    for name, text in page.files(FOLDER).items():
        assert (FOLDER / name).read_text("utf-8") == text, "write it again with: python -m benchmarks.study page"


def test_the_readmes_caption_says_what_the_result_says() -> None:
    caption = (DOCS.parent / "README.md").read_text("utf-8").split("**It is for**")[0]
    result = json.loads((DOCS / "results/physical.json").read_text("utf-8"))
    said = " ".join(thing["sentence"] for thing in result["change"]["things"])
    for words in ("dented by 0.37 mm in the root mean square", "3.4 % dimmer"):
        assert words in " ".join(caption.split())
        assert words in said
    assert "20 % narrower in its highlights, 26 % stronger in its gloss" in said
    assert "gloss is 26 % stronger and its highlights 20 % narrower" in " ".join(caption.split())
    assert result["attacked"]["label"] == "spotlight"
