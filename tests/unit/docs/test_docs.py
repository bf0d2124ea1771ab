"""The documents against the code: nothing left out, nothing that is not there."""

import re
from pathlib import Path

import pytest
from pydantic import BaseModel

from scene_attack.runs.spec import Goal
from scene_attack.scenes.description import (
    Camera,
    DirectionalLight,
    Environment,
    Floor,
    Lights,
    PointLight,
    SceneObject,
    SpotLight,
)
from scene_attack_api.main import create_app
from scene_attack_service.settings import Settings
from tests.unit.client.test_cli import COMMANDS

ROOT = Path(__file__).parents[3]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]


def text(name: str) -> str:
    return (ROOT / "docs" / name).read_text()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for link in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text()):
        if not link.startswith("http"):
            assert (page.parent / link).exists(), link


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_files_that_are_named_exist(page: Path) -> None:
    folders = "api|benchmarks|client|deploy|docs|examples|scripts|services|tests|training|worker"
    for path in re.findall(rf"`((?:{folders})/[\w./-]*\w)/?`", page.read_text()):
        assert (ROOT / path).exists(), path


def test_operations_has_every_setting_and_its_default() -> None:
    for name, field in Settings.model_fields.items():
        default = "–" if field.default in (None, ()) else f"`{field.default}`"
        line = f"| `SCENE_ATTACK_{name.upper()}` | {default} | {field.description} |"
        assert text("operations.md").count(line) == 1, name


@pytest.mark.parametrize(
    "model", [Camera, SceneObject, Floor, Lights, PointLight, DirectionalLight, SpotLight, Environment, Goal]
)
def test_page_of_fields_has_every_field_as_it_is_described(model: type[BaseModel]) -> None:
    page = text("reference/fields.md")
    for name, field in model.model_fields.items():
        row = next((line for line in page.splitlines() if line.startswith(f"| `{name}` |")), None)
        assert row is not None, name
        assert field.description is None or f"| {field.description} |" in page


def test_start_has_every_command_and_every_example() -> None:
    page = text("index.md")
    for command in COMMANDS:
        if command not in ([], ["jobs"], ["assets"], ["scene"], ["accuracy"], ["campaign"], ["keys"]):
            assert f"scene-attack {' '.join(command)}" in page
    for example in (ROOT / "examples").glob("*.json"):
        assert f"`{example.name}`" in page
    for named in re.findall(r"examples/[\w-]+\.json", page + (ROOT / "README.md").read_text()):
        assert (ROOT / named).exists()


def test_api_page_has_every_path() -> None:
    page = text("reference/api.md")
    for path, operations in create_app(Settings()).openapi()["paths"].items():
        for method in operations:
            assert f"### `{method.upper()} {path}`" in page
