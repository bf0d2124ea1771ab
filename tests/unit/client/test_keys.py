"""The commands `keys` on a real database."""

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from scene_attack.cli.app import app
from scene_attack.errors import InvalidRequest
from scene_attack_service.access.keys import AccessKeys
from scene_attack_service.jobs.database import connect
from scene_attack_service.settings import Settings

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SCENE_ATTACK_DATA", str(tmp_path))
    return tmp_path


def keys(*arguments: str) -> Any:
    done = CliRunner().invoke(app, ["keys", *arguments, "--json"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


def find(data: Path, text: str) -> str | None:
    engine = connect(Settings(data=data))
    found = AccessKeys(engine).find(text)
    engine.dispose()
    return None if found is None else found.prefix


def test_a_key_is_made_listed_and_revoked(data: Path) -> None:
    made = keys("create", "alice")
    assert (made["owner"], made["scopes"]) == ("alice", ["assets:write", "jobs:read", "jobs:write"])
    assert find(data, made["key"]) == made["prefix"]
    [listed] = keys("list")
    assert listed["state"] == "valid"
    assert made["key"] not in json.dumps(listed)
    assert keys("revoke", made["prefix"])["state"] == "revoked"
    assert find(data, made["key"]) is None


def test_the_text_of_a_key_is_all_of_stdout(data: Path) -> None:
    done = CliRunner().invoke(app, ["keys", "create", "ci", "--owner", "", "--scope", "admin", "--days", "90"])
    assert find(data, done.stdout.strip()) is not None
    [listed] = keys("list")
    assert (listed["owner"], listed["scopes"]) == ("", ["admin"])
    assert listed["expires"] > listed["created"]
    assert done.stdout.strip() not in CliRunner().invoke(app, ["keys", "list"]).output


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        (["create", "alice", "--scope", "everything"], "--scope"),
        (["create", ""], "NAME"),
        (["create", "x" * 101], "NAME"),
        (["create", "alice", "--owner", "a\nb"], "--owner"),
        (["create", "a\u202eb"], "NAME"),
        (["create", " "], "NAME"),
        (["create", "alice", "--days", "0"], "--days"),
        (["create", "alice", "--days", "1e9"], "--days"),
        (["create", "alice", "--days", "nan"], "--days"),
        (["revoke", "sa_0000000000"], "PREFIX"),
    ],
)
def test_what_is_wrong_is_said(arguments: list[str], field: str) -> None:
    with pytest.raises(InvalidRequest) as refused:
        CliRunner().invoke(app, ["keys", *arguments], catch_exceptions=False)
    assert refused.value.field == field
    assert keys("list") == []


def test_a_key_of_another_data_folder_says_where_it_is(data: Path) -> None:
    other = data / "other"
    done = CliRunner().invoke(app, ["keys", "create", "alice", "--data", str(other)])
    assert find(other, done.stdout.strip()) is not None
    assert f"It is in {other}." in done.stderr
    assert keys("list", "--data", str(data)) == []
