"""What the command line says, and with which exit code."""

import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from scene_attack.cli.app import app
from scene_attack.cli.commands_page import commands
from scene_attack.runs.result import PlannedCost
from tests.unit.client.command_line import cli, process

pytestmark = pytest.mark.slow

COMMANDS = [[], *(name.split()[1:] for name, _ in commands())]


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_has_help_with_an_example(command: list[str]) -> None:
    done = CliRunner().invoke(app, [*command, "--help"])
    assert done.exit_code == 0
    groups = ([], ["jobs"], ["assets"], ["scene"], ["accuracy"], ["campaign"], ["keys"])
    assert ("Example" in done.stdout) == (command not in groups)


NETWORKS_AND_RENDERERS = {"torch", "scipy", "trimesh", "OpenGL", "pyrender"}
NOBODY = "--url http://127.0.0.1:1"


@pytest.mark.parametrize(
    ("arguments", "heavy"),
    [
        ("--help", NETWORKS_AND_RENDERERS | {"numpy", "sqlalchemy", "fastapi", "httpx"}),
        ("targets", NETWORKS_AND_RENDERERS),
        ("assets list --category primitive", NETWORKS_AND_RENDERERS),
        ("assets environments", NETWORKS_AND_RENDERERS),
        ("scene show no-such-file.glb", {"torch", "OpenGL", "pyrender"}),
        ("assets show primitive/no-such-mesh", NETWORKS_AND_RENDERERS),
        (f"jobs list {NOBODY}", NETWORKS_AND_RENDERERS | {"sqlalchemy", "fastapi"}),
        (f"jobs show some-job {NOBODY}", NETWORKS_AND_RENDERERS | {"sqlalchemy", "fastapi"}),
        (f"submit {{spec}} {NOBODY}", NETWORKS_AND_RENDERERS | {"sqlalchemy", "fastapi"}),
        ("plan no-such-file", NETWORKS_AND_RENDERERS),
        ("plan {spec}", {"sympy", "sqlalchemy", "fastapi", "httpx"}),
    ],
)
def test_a_command_imports_nothing_heavy_that_it_does_not_need(arguments: str, heavy: set[str], tmp_path: Path) -> None:
    """The start of a command takes a second for torch, half of one for pyrender, half of one for sympy."""
    spec = tmp_path / "spec.json"
    spec.write_text(PLANNED % "1e-3")
    code = (
        f"import sys; sys.argv = ['scene-attack', *{arguments.format(spec=spec).split()!r}]\n"
        "try:\n    from scene_attack.cli.app import main; main()\nexcept SystemExit: pass\n"
        f"heavy = {heavy!r} & set(sys.modules)\n"
        "sys.exit(repr(heavy) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_version() -> None:
    assert process("--version").stdout.startswith("scene-attack 0.")


@pytest.mark.parametrize(
    ("spec", "field"),
    [
        ('{"scene": {"objects": [{"mesh": "primitive/cube"}], "camera": {"distance": -1}}}', "scene.camera.distance"),
        ("nonsense", "SPEC"),
    ],
)
def test_run_names_the_bad_field_and_exits_2(spec: str, field: str, tmp_path: Path) -> None:
    done = cli("run", "-", "--out", str(tmp_path / "out"), stdin=spec)
    assert done.returncode == 2
    assert field in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""


PLANNED = '{"scene": {"objects": [{"mesh": "primitive/sphere"}], "camera": {"size": [64, 64]}}, "tolerance": %s}'


def test_a_plan_is_printed_and_is_json_for_machines() -> None:
    done = cli("plan", "-", stdin=PLANNED % "1e-3")
    assert done.returncode == 0, done.stderr
    assert "object 0 directions" in done.stdout
    found = PlannedCost.model_validate_json(cli("plan", "-", "--json", stdin=PLANNED % "1e-3").stdout)
    assert 0 < found.plan.error <= found.plan.tolerance == 1e-3
    assert f"up to {found.cost.steps:,} steps; an image takes " in done.stdout
    exact = PlannedCost.model_validate_json(cli("plan", "-", "--json", stdin=PLANNED % '"exact"').stdout)
    assert exact.plan.error == 0


def test_a_plan_shows_its_progress_on_a_terminal_and_not_in_its_output(tmp_path: Path) -> None:
    spec = tmp_path / "spec.json"
    spec.write_text(PLANNED % "1e-3")
    ours, terminal = pty.openpty()
    command = [sys.executable, "-m", "scene_attack", "plan", str(spec), "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=terminal, env=os.environ | {"TERM": "xterm"}) as plan:
        os.close(terminal)
        shown = b"".join(iter(lambda: _read(ours), b""))
        assert plan.stdout is not None
        PlannedCost.model_validate_json(plan.stdout.read())
    os.close(ours)
    assert plan.returncode == 0
    assert shown.index(b"loading") < shown.index(b"planning")


def _read(terminal: int) -> bytes:
    try:
        return os.read(terminal, 4096)
    except OSError:  # the other end is closed
        return b""


@pytest.mark.parametrize("tolerance", ["0", "0.5", '"none"', "NaN"])
def test_a_bad_tolerance_is_named(tolerance: str) -> None:
    done = cli("plan", "-", stdin=PLANNED % tolerance)
    assert done.returncode == 2
    assert "bad input: tolerance:" in done.stderr


def test_submit_without_a_service_says_how_to_get_one() -> None:
    done = cli("submit", "-", "--url", "http://127.0.0.1:1", stdin='{"scene": {}}')
    assert done.returncode == 1
    assert "scene-attack serve" in done.stderr


@pytest.mark.parametrize("command", ["run - --out {out}", "serve"])
def test_a_device_that_is_not_there_is_named_before_anything_starts(command: str, tmp_path: Path) -> None:
    """By a process; that every other command refuses it too, `tests/unit/test_device.py` says."""
    out = tmp_path / "out"
    data = {"SCENE_ATTACK_DATA": str(tmp_path / "data"), "SCENE_ATTACK_REDIS_URL": "redis://127.0.0.1:1"}
    arguments = command.format(out=out).split()
    done = process(*arguments, stdin=PLANNED % "1e-3", SCENE_ATTACK_DEVICE="cuda:99", **data)
    assert done.returncode == 2, done.stderr
    assert "SCENE_ATTACK_DEVICE=cuda:99: this machine has" in done.stderr
    assert "use auto or cpu" in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_device_with_another_name_is_a_bad_setting() -> None:
    done = cli("plan", "-", stdin=PLANNED % "1e-3", SCENE_ATTACK_DEVICE="gpu")
    assert done.returncode == 2
    assert "bad input: SCENE_ATTACK_DEVICE:" in done.stderr


def test_an_upload_of_an_unknown_kind_is_refused_before_it_is_sent(tmp_path: Path) -> None:
    (tmp_path / "scene.blend").write_bytes(b"x")
    done = cli("assets", "add", str(tmp_path / "scene.blend"), "--url", "http://127.0.0.1:1")
    assert done.returncode == 2
    assert "obj, ply, stl, glb, off" in done.stderr


def test_the_export_of_a_folder_that_is_not_there_says_so(tmp_path: Path) -> None:
    done = cli("campaign", "export", "out/nothing", "--maite", str(tmp_path / "out"))
    assert done.returncode == 2
    assert "source: there is no folder out/nothing" in done.stderr


def test_targets_for_machines() -> None:
    names = [target["name"] for target in json.loads(cli("targets", "--json").stdout)]
    assert "efficientnet-lite0" in names


def test_only_an_upload_is_deleted() -> None:
    done = cli("assets", "delete", "furniture/grand-piano")
    assert done.returncode == 2
    assert "is not the name of an uploaded mesh" in done.stderr


def test_assets_are_listed_from_the_cache_given(tmp_path: Path) -> None:
    environ = {"SCENE_ATTACK_CACHE": str(tmp_path), "SCENE_ATTACK_DATA": str(tmp_path)}
    listed = json.loads(cli("assets", "list", "--json", **environ).stdout)
    kinds = [entry["kind"] for entry in listed]
    assert (set(kinds), kinds.count("furniture")) == (
        {"primitive", "furniture"},
        10,
    )
    shown = json.loads(cli("assets", "show", listed[0]["name"], "--json", **environ).stdout)
    assert shown["faces"] > 0
