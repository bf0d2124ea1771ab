import errno
import fcntl
import json
import os
from pathlib import Path

import pytest

from scene_attack.errors import InvalidRequest
from scene_attack_worker.stack import LOCK_FILE, ServiceLock


def test_one_at_a_time_holds_it(tmp_path: Path) -> None:
    with ServiceLock(tmp_path) as lock:
        with pytest.raises(InvalidRequest, match=f"already, process {os.getpid()} which is starting; "):
            ServiceLock(tmp_path)
        lock.tell("http://127.0.0.1:8008")
        with pytest.raises(InvalidRequest, match=f"already, process {os.getpid()} at http://127.0.0.1:8008; "):
            ServiceLock(tmp_path)
        (tmp_path / LOCK_FILE).write_text("")  # as in the moment in which it is written
        with pytest.raises(InvalidRequest, match="already, which is just starting; "):
            ServiceLock(tmp_path)
    with ServiceLock(tmp_path):
        assert json.loads((tmp_path / LOCK_FILE).read_text()) == {"pid": os.getpid(), "url": None}


def test_no_child_holds_it(tmp_path: Path) -> None:
    with ServiceLock(tmp_path):
        held = [fd for fd in os.listdir("/proc/self/fd") if os.path.realpath(f"/proc/self/fd/{fd}").endswith(LOCK_FILE)]
        assert [os.get_inheritable(int(fd)) for fd in held] == [False]


def test_a_file_system_without_locks_is_no_reason_not_to_start(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    def unsupported(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", unsupported)
    with ServiceLock(tmp_path):
        said = capsys.readouterr()
        assert "no lock on the data folder" in said.out + said.err + caplog.text  # by whatever logging is set up
