"""Options that are settings, each in a process of its own with a HOME of its own, over variables that say otherwise."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from sqlite3 import connect
from typing import Any

import httpx
import pytest

from tests.integration.machine import Machine
from tests.postgresql import free_port

pytestmark = pytest.mark.integration


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path / "home")


@pytest.fixture
def folder(tmp_path: Path) -> str:
    return str(tmp_path / "folder")


def address(log: Iterator[dict[str, Any]]) -> str:
    """Where the API listens, by its log."""
    host, port = next(line["address"] for line in log if line["event"] == "listening")
    return f"http://{host}:{port}"


def test_keys_are_those_of_the_folder(tmp_path: Path, machine: Machine, folder: str, redis_url: str) -> None:
    made = machine.json("keys", "create", "alice", "--data", folder)
    assert not (tmp_path / "home").exists()
    assert [key["prefix"] for key in machine.json("keys", "list", "--data", folder)] == [made["prefix"]]
    key = {"Authorization": f"Bearer {made['key']}"}
    service = Machine(tmp_path / "home", SCENE_ATTACK_REDIS_URL=redis_url)
    with service.logging("api", "--data", folder, "--port", "0") as log, httpx.Client(base_url=address(log)) as client:
        assert client.get("/v1/jobs").status_code == 401
        assert client.get("/v1/jobs", headers=key).status_code == 200
        assert machine.json("keys", "revoke", made["prefix"], "--data", folder)["state"] == "revoked"
        assert client.get("/v1/jobs", headers=key).status_code == 401
    assert machine.json("keys", "list") == []


def test_a_backup_is_of_the_folder(tmp_path: Path, machine: Machine, folder: str) -> None:
    machine.json("keys", "create", "alice", "--data", folder)
    machine.json("backup", str(tmp_path / "copy"), "--data", folder)
    with closing(connect(tmp_path / "copy" / "jobs.sqlite")) as copy:
        assert copy.execute("SELECT name FROM access_keys").fetchall() == [("alice",)]


@pytest.mark.parametrize("command", ["serve", "api", "worker"])
def test_options_take_precedence_over_variables(command: str, tmp_path: Path, folder: str, redis_url: str) -> None:
    wrong = {"HOST": "127.0.0.3", "PORT": "1", "WORKERS": "1", "DATA": str(tmp_path / "wrong")}
    variables = {f"SCENE_ATTACK_{name}": value for name, value in wrong.items()} | {"SCENE_ATTACK_REDIS_URL": redis_url}
    options, port = ["--data", folder], free_port()
    if command != "worker":
        options += ["--host", "127.0.0.2", "--port", str(port)]
    if command != "api":
        options += ["--workers", "2"]
    with Machine(tmp_path / "home", **variables).logging(command, *options) as log:
        if command != "api":
            assert any(line.get("program") == "worker-1" for line in log if line["event"] == "program started")
        if command != "worker":
            assert address(log) == f"http://127.0.0.2:{port}"
        assert Path(folder).is_dir()
    assert not (tmp_path / "wrong").exists()


@pytest.mark.parametrize("arguments", ["serve --port 99999", "api --port 99999", "worker --workers 0"])
def test_a_wrong_option_is_named_as_it_was_written(arguments: str, machine: Machine) -> None:
    command, option, value = arguments.split()
    code, _, stderr = machine.run(command, option, value)
    most = "must be at most 65535" if option == "--port" else "must be at least 1"
    assert (code, stderr) == (2, f"scene-attack: bad input: {option}: {most}, not {value}\n")


def test_importing_reads_no_setting() -> None:
    """Every module of the program, where reading the settings fails. Alembic alone runs its environment; the compiled
    kernels, whose names have a hyphen, are no modules.
    """
    code = (
        "import importlib, pkgutil\n"
        "for name in ('', '_service', '_questions', '_accuracy', '_api', '_worker'):\n"
        "    root = f'scene_attack{name}'\n"
        "    for module in pkgutil.walk_packages(importlib.import_module(root).__path__, f'{root}.'):\n"
        "        if '-' in module.name or module.name.endswith('migrations.env'): continue\n"
        "        importlib.import_module(module.name)\n"
        "from scene_attack_service.settings import Settings\n"
        "try: Settings()\n"
        "except ValueError: print('refused')\n"
    )
    environ = os.environ | {"SCENE_ATTACK_PORT": "none"}
    done = subprocess.run([sys.executable, "-c", code], env=environ, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "refused\n"), done.stderr
