from pathlib import Path

import pytest

from scene_attack.errors import InvalidRequest
from scene_attack_service.access.caller import Scope
from scene_attack_service.access.keys import AccessKeys, check_listening
from scene_attack_service.settings import Settings
from tests.unit.client.command_line import process

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "", "192.0.2.7", "service.example"])
def test_a_service_without_a_key_does_not_listen_where_others_reach_it(host: str, tmp_path: Path) -> None:
    settings = Settings(data=tmp_path, host=host)
    with pytest.raises(InvalidRequest, match="scene-attack keys create") as refused:
        check_listening(settings)
    assert refused.value.field == "--host"


@pytest.mark.parametrize("host", ["127.0.0.1", "127.1.2.3", "::1", "localhost"])
def test_loopback_needs_no_key(host: str, tmp_path: Path) -> None:
    check_listening(Settings(data=tmp_path / "none", host=host))
    assert not (tmp_path / "none").exists()


def test_with_a_key_it_listens_anywhere(keys: AccessKeys, database: Settings) -> None:
    keys.create("operator", "operator", {Scope.ADMIN})
    check_listening(database.model_copy(update={"host": "0.0.0.0"}))


@pytest.mark.parametrize("command", ["serve", "api"])
def test_a_command_refuses_before_it_starts_anything(command: str, tmp_path: Path) -> None:
    """In a process of its own, as the command decides how a process writes its log."""
    place = ["--host", "0.0.0.0", "--port", "0", "--data", str(tmp_path)]
    done = process(command, *place, SCENE_ATTACK_REDIS_URL="redis://127.0.0.1:1")
    assert done.returncode == 2
    assert "--host" in done.stderr
    assert "has no key yet" in done.stderr
    assert "listening" not in done.stdout
