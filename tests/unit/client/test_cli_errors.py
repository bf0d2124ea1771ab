"""What goes wrong around the service is said in one line, with the setting or option to mend, and no traceback."""

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.unit.client.test_cli import cli

NOBODY = "http://127.0.0.1:1"


@pytest.fixture
def taken() -> Iterator[int]:
    """A port that somebody else listens on."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener.getsockname()[1]


def said(*arguments: str, **environ: str) -> tuple[int, str]:
    """The exit code, and what follows "scene-attack: " in the last line of stderr, which has no traceback."""
    done = cli(*arguments, **environ)
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    return done.returncode, done.stderr.splitlines()[-1].removeprefix("scene-attack: ")


@pytest.mark.parametrize("program", ["serve", "api"])
def test_a_taken_port(program: str, taken: int, tmp_path: Path) -> None:
    redis = {"SCENE_ATTACK_REDIS_URL": "redis://127.0.0.1:1"}
    code, text = said(program, "--port", str(taken), "--data", str(tmp_path), **redis)
    assert (code, text) == (
        2,
        f"bad input: --port: cannot listen on 127.0.0.1:{taken} (Address already in use); try --port 0",
    )


@pytest.mark.parametrize("program", ["serve", "api", "worker"])
def test_a_data_folder_that_cannot_be_made(program: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    redis = {"SCENE_ATTACK_REDIS_URL": "redis://127.0.0.1:1"}
    code, text = said(program, "--data", str(tmp_path / "file"), **redis)
    assert code == 2
    assert text.startswith(f"bad input: SCENE_ATTACK_DATA: the folder {tmp_path / 'file'} cannot be made")


@pytest.mark.parametrize("program", ["api", "worker"])
def test_no_redis_for_parts_of_the_service(program: str, tmp_path: Path) -> None:
    code, text = said(program, "--data", str(tmp_path / "data"))
    assert code == 2
    assert text.startswith("bad input: SCENE_ATTACK_REDIS_URL: is needed")
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize("program", ["serve", "api", "worker"])
def test_a_url_that_is_no_redis_is_not_shown_because_it_may_have_a_password(program: str, tmp_path: Path) -> None:
    code, text = said(program, "--data", str(tmp_path / "data"), SCENE_ATTACK_REDIS_URL="http://:secret@redis:6379")
    assert code == 2
    assert text.startswith("bad input: SCENE_ATTACK_REDIS_URL: must be a URL such as redis://")
    assert "secret" not in text


@pytest.mark.parametrize("command", ["serve", "keys list"])
def test_a_database_that_is_away(command: str, tmp_path: Path) -> None:
    url = "postgresql://alice:secret@127.0.0.1:1/scenes"
    code, text = said(*command.split(), SCENE_ATTACK_DATABASE_URL=url, SCENE_ATTACK_DATA=str(tmp_path / "data"))
    assert code == 1
    assert text.startswith("the database does not answer")
    assert text.endswith("scene-attack doctor says what to do")
    assert "secret" not in text


@pytest.mark.parametrize("url", ["127.0.0.1:8008", "htp://127.0.0.1", "http://"])
def test_an_address_that_is_none(url: str) -> None:
    code, text = said("jobs", "list", "--url", url)
    assert code == 2
    assert text == f"bad input: --url: '{url}' is no address of a service, such as http://127.0.0.1:8008"


@pytest.mark.parametrize("key", ["sa_schlüssel", "sa_a\nb"])
def test_a_key_that_is_none(key: str) -> None:
    code, text = said("jobs", "list", "--url", NOBODY, SCENE_ATTACK_KEY=key)
    assert code == 2
    assert text.startswith("bad input: SCENE_ATTACK_KEY: ")
    assert key not in text


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    code, text = said("jobs", "download", "some-job", "--url", NOBODY, "--out", str(tmp_path / "file/out"))
    assert code == 1
    assert "file" in text


def test_a_folder_of_a_network_that_is_left_out_is_named_where_it_is_asked_for(tmp_path: Path) -> None:
    (tmp_path / "mine/empty").mkdir(parents=True)
    targets = {"SCENE_ATTACK_TARGETS": str(tmp_path / "mine")}
    assert "target left out: empty: card.json" in cli("targets", **targets).stderr
    assert cli("plan", "no-such-file", **targets).stderr.startswith("scene-attack: bad input: SPEC: ")
    assert "card.json" in cli("targets", "check", "empty", **targets).stderr
