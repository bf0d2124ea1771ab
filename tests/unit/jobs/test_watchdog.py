from pathlib import Path

import pytest

from scene_attack_service.jobs import processes


@pytest.fixture(autouse=True)
def _said_long_ago(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "_said_alive", float("-inf"))


def test_a_sign_is_heard_once(monkeypatch: pytest.MonkeyPatch) -> None:
    listener = processes.Listener()
    monkeypatch.setenv("NOTIFY_SOCKET", listener.environ["NOTIFY_SOCKET"])
    assert not listener.heard()
    processes.say_alive()
    assert listener.heard()
    assert not listener.heard()
    processes.say_alive()  # at once after the last one: nothing is sent
    assert not listener.heard()
    listener.close()


def test_a_program_that_no_one_listens_to_goes_on(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    processes.say_started()
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "nobody"))
    processes.say_started()
    deaf = processes.Listener()
    monkeypatch.setenv("NOTIFY_SOCKET", deaf.environ["NOTIFY_SOCKET"])
    for _ in range(5000):  # more than the kernel keeps for it
        processes.say_started()
    deaf.close()
