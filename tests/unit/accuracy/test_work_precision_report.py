"""The work-precision report of parts that were measured alone, of given rows."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from client.cli import app
from services.accuracy.work_precision import scene_options
from services.accuracy.work_precision.report import QUICK, Report, markdown, measure, read
from services.accuracy.work_precision.scene_options import OptionRow

MAP = OptionRow(scene="matte", renderer="torch", setting="4×8 texels", mean=0.25, share=0.5, largest=0.5, seconds=1.0)
SHADOW = MAP.model_copy(update={"scene": "s", "setting": "texel_samples 1"})


def test_a_part_measured_alone_replaces_its_rows_and_no_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The report says of each part by which command it was measured."""
    monkeypatch.setattr(scene_options, "map_rows", lambda *_: iter([MAP]))
    monkeypatch.setattr(scene_options, "shadow_rows", lambda *_: iter([SHADOW]))
    assert read(tmp_path) is None
    assert list(measure(QUICK, tmp_path, "the first", ["maps", "shadows"]).measured) == ["maps", "shadows"]
    again = SHADOW.model_copy(update={"mean": 0.125})
    monkeypatch.setattr(scene_options, "shadow_rows", lambda *_: iter([again]))
    made = measure(QUICK, tmp_path, "the second", ["shadows"])
    assert (made.maps, made.shadows) == ([MAP], [again])
    assert {name: how.command for name, how in made.measured.items()} == {"maps": "the first", "shadows": "the second"}
    page = markdown(made)
    assert "- shadows: `the second`, " in page
    assert "- maps: `the first`, " in page
    assert "## Plans" not in page


def test_what_was_measured_is_kept_when_a_later_part_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(scene_options, "map_rows", lambda *_: iter([MAP]))
    monkeypatch.setattr(scene_options, "shadow_rows", stopped)
    with pytest.raises(KeyboardInterrupt):
        measure(QUICK, tmp_path, "a command", ["maps", "shadows"])
    made = read(tmp_path)
    assert made is not None
    assert (made.maps, list(made.measured)) == ([MAP], ["maps"])


def test_the_command_measures_a_part_into_the_report_that_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene_options, "map_rows", lambda *_: iter([MAP]))
    (tmp_path / "work-precision.json").write_text(Report(shadows=[SHADOW]).model_dump_json(), "utf-8")
    command = ["accuracy", "work-precision", "--quick", "--out", str(tmp_path), "--only", "maps"]
    assert CliRunner().invoke(app, command).exit_code == 0
    made = read(tmp_path)
    assert made is not None
    assert (made.maps, made.shadows) == ([MAP], [SHADOW])
    words = f"scene-attack accuracy work-precision --only maps --quick --out {tmp_path}"
    assert [how.command for how in made.measured.values()] == [words]
    unknown = CliRunner().invoke(app, ["accuracy", "work-precision", "--only", "mops"])
    assert unknown.exit_code == 2
    assert "maps" in unknown.output
