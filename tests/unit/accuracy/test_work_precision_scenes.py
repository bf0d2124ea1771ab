"""What the work-precision report says of a scene's options, on a small image; and parts that are measured alone."""

from itertools import product
from pathlib import Path

import pytest
from typer.testing import CliRunner

from client.cli import app
from services.accuracy.work_precision import map_resolution, scene_options
from services.accuracy.work_precision.collect import Found, collect
from services.accuracy.work_precision.extent import QUICK
from services.accuracy.work_precision.map_resolution import MapRow
from services.accuracy.work_precision.report import markdown, read, report, write
from services.accuracy.work_precision.scene_options import TOLERANCES, SceneRow, scenes
from services.accuracy.work_precision.shadow_resolution import ShadowRow

pytestmark = pytest.mark.slow

NAMES = ["matte objects", "rubber and metal", "floor", "shadows"]
MAP = MapRow(mesh="m", material="matte", map=(4, 8), reference=(64, 128), pixels=1, largest=0.5, rms=0.5)
SHADOW = ShadowRow(
    scene="s", renderer="torch", fineness="1×1", reference="8×8", pixels=1, mean=0.25, largest=0.5, seconds=1.0
)


@pytest.fixture(scope="module")
def rows() -> list[SceneRow]:
    return list(scene_options.rows((24, 32), 0.0))


def test_each_scene_has_one_more_option() -> None:
    found = dict(scenes((24, 32)))
    assert list(found) == NAMES
    assert [of.floor is not None for of in found.values()] == [False, False, True, True]
    assert [of.shadows is not None for of in found.values()] == [False, False, False, True]
    for name, of in found.items():
        assert {one.material for one in of.objects} <= ({"matte"} if name == NAMES[0] else {"rubber", "metal"})
        assert all((one.metallic is None) == (name == NAMES[0]) for one in of.objects)


def test_every_scene_is_measured_with_both_renderers_within_every_tolerance(rows: list[SceneRow]) -> None:
    wanted = list(product(NAMES, ("pyrender", "torch"), TOLERANCES))
    assert [(row.scene, row.renderer, row.tolerance) for row in rows] == wanted
    for row in rows:
        if row.tolerance == "exact":
            assert row.largest == 0
            continue
        assert row.mean <= row.tolerance
        if row.renderer == "torch":
            assert 0 < row.largest <= row.estimate <= row.tolerance
    assert {row.pixels for row in rows if row.scene == "shadows"} == {24 * 32}  # the floor fills the image


def test_a_part_measured_alone_replaces_its_rows_and_no_others(tmp_path: Path) -> None:
    """The report says of each part by which command it was measured."""
    first = report(Found(maps=[MAP], shadows=[SHADOW]), "the first command", "none")
    write(first, tmp_path)
    before = read(tmp_path)
    assert before == first
    again = SHADOW.model_copy(update={"mean": 0.125})
    write(report(Found(shadows=[again]), "the second command", "none", ["shadows"], before), tmp_path)
    merged = read(tmp_path)
    assert merged is not None
    assert (merged.maps, merged.shadows) == ([MAP], [again])
    assert {name: one.command for name, one in merged.measured.items()} == dict.fromkeys(
        first.measured, "the first command"
    ) | {"shadows": "the second command"}
    page = markdown(merged)
    assert "- shadows: `the second command`, " in page
    assert "`the first command`, " in page
    assert "Not measured yet." in page


def test_a_report_of_one_part_alone_says_which(tmp_path: Path) -> None:
    assert read(tmp_path) is None
    assert list(report(Found(maps=[MAP]), "a command", "none", ["maps"]).measured) == ["maps"]


def test_only_the_named_parts_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_resolution, "rows", lambda *_: iter([MAP]))
    assert collect(QUICK, only=["maps"]) == Found(maps=[MAP])


def test_the_command_measures_a_part_into_the_report_that_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(map_resolution, "rows", lambda *_: iter([MAP]))
    write(report(Found(shadows=[SHADOW]), "before", "none", ["shadows"]), tmp_path)
    command = ["accuracy", "work-precision", "--quick", "--out", str(tmp_path), "--only", "maps"]
    assert CliRunner().invoke(app, command).exit_code == 0
    made = read(tmp_path)
    assert made is not None
    assert (made.maps, made.shadows) == ([MAP], [SHADOW])
    words = f"scene-attack accuracy work-precision --only maps --quick --out {tmp_path}"
    assert [one.command for one in made.measured.values()] == ["before", words]
    assert not list(tmp_path.glob("*.partial.jsonl"))
    unknown = CliRunner().invoke(app, ["accuracy", "work-precision", "--only", "mops"])
    assert unknown.exit_code == 2
    assert "maps" in unknown.output
