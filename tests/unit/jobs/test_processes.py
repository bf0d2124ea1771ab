"""Child processes: messages, their end, hangs, and the processor time that they leave to others."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from scene_attack_service.jobs import processes as module
from scene_attack_service.jobs.processes import (
    AUTOGROUP,
    LONGEST_GAP,
    NICENESS,
    SIGN_SECONDS,
    Child,
    ChildDied,
    HangDetector,
    OutOfMemory,
    processor_seconds,
)
from scene_attack_service.settings import Settings

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("children_of_tests")]


ECHO = "tests.unit.jobs.echo_child"


@pytest.fixture
def child(tmp_path: Path) -> Iterator[Child]:
    child = Child(ECHO, Settings(data=tmp_path))
    assert child.receive(30) == {"ready": child.pid, "allocator": str(256 * 2**20)}
    yield child
    child.kill()


def test_it_answers_messages(child: Child) -> None:
    child.send({"do": "echo", "text": "line\nline\n" * 1000})
    assert child.receive(10) == {"message": {"do": "echo", "text": "line\nline\n" * 1000}}
    assert child.alive()
    assert child.memory() > 2**20


def test_its_death_is_told_not_waited_for(child: Child) -> None:
    child.send({"do": "die"})
    with pytest.raises(ChildDied):
        child.receive(30)
    assert child.kill() == -9
    assert not child.alive()
    assert child.memory() == 0


def test_one_that_says_it_needs_too_much_memory_stays(child: Child) -> None:
    child.send({"do": "give up"})
    with pytest.raises(OutOfMemory, match="SCENE_ATTACK_JOB_MEMORY_BYTES"):
        child.receive(30)
    child.send({"do": "echo"})
    assert child.receive(10) == {"message": {"do": "echo"}}


def test_one_that_has_too_much_memory_is_killed_also_if_it_is_shared(tmp_path: Path) -> None:
    child = Child(ECHO, Settings(data=tmp_path))
    child.receive(30)
    child.limit = child.memory() + 2**25
    child.send({"do": "fill"})
    with pytest.raises(OutOfMemory, match="SCENE_ATTACK_JOB_MEMORY_BYTES"):
        child.receive(60)
    assert not child.alive()
    assert child.kill() == -signal.SIGKILL


def test_silence_is_not_death(child: Child) -> None:
    child.send({"do": "hang"})
    assert child.receive(0.05) is None
    assert child.alive()


def test_a_child_that_takes_no_request_is_killed(child: Child, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SEND_SECONDS", 0.1)
    os.kill(child.pid, signal.SIGSTOP)
    with pytest.raises(ChildDied):
        child.send({"do": "echo", "text": "x" * 2**23})
    assert child.kill() == -9


@pytest.mark.parametrize("doing", ["nothing", "hang", "stop"])
def test_it_does_not_outlive_a_parent_that_is_killed(doing: str) -> None:
    script = f"""
from scene_attack_service.jobs.processes import Child
from scene_attack_service.settings import Settings
child = Child({ECHO!r}, Settings())
child.receive(30)
if {doing!r} != "nothing":
    child.send({{"do": {doing!r}}})
print(child.pid, flush=True)
child.receive(60)
"""
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        os.kill(pid, 0)  # it lives
        parent.kill()
    deadline = time.monotonic() + 10
    while _runs(pid):
        assert time.monotonic() < deadline
        time.sleep(0.01)


def _runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


SPIN = "while True: pass"


class Seconds:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def spinning() -> Iterator["subprocess.Popen[bytes]"]:
    with subprocess.Popen([sys.executable, "-c", SPIN], start_new_session=True) as process:
        yield process
        process.kill()


def use(session: int, seconds: float) -> None:
    """Waits until the session has used so much more of the processor."""
    until = processor_seconds(session) + seconds
    while processor_seconds(session) < until:
        pass


def test_a_process_that_computes_is_not_still_and_a_stopped_one_is(spinning: "subprocess.Popen[bytes]") -> None:
    clock = Seconds()
    detector = HangDetector(spinning.pid, clock)
    for _ in range(3):
        use(spinning.pid, 2 * SIGN_SECONDS)  # once would leave the verdict to rounding
        clock.now += 1
        assert detector.seconds() == 0
    os.kill(spinning.pid, signal.SIGSTOP)
    os.waitpid(spinning.pid, os.WUNTRACED)  # until it is stopped
    clock.now += 1
    detector.seconds()  # it may have used some before it was stopped
    before = detector.seconds()
    for n in range(1, 4):
        clock.now += 1
        assert detector.seconds() == before + n


def test_what_its_children_compute_counts(spinning: "subprocess.Popen[bytes]") -> None:
    session = os.getsid(spinning.pid)
    script = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {SPIN!r}])"
    with subprocess.Popen([sys.executable, "-c", script], start_new_session=True) as parent:
        assert os.getsid(parent.pid) != session
        use(parent.pid, 0.3)  # the start of two interpreters takes less
        os.killpg(parent.pid, signal.SIGKILL)


def test_time_in_which_the_caller_slept_itself_does_not_count(spinning: "subprocess.Popen[bytes]") -> None:
    os.kill(spinning.pid, signal.SIGSTOP)
    clock = Seconds()
    detector = HangDetector(spinning.pid, clock)
    clock.now += 3600
    assert detector.seconds() <= LONGEST_GAP


SCRIPT = f"""
import os
from scene_attack_service.jobs.processes import give_way
give_way()
print(os.nice(0))
print(open({str(AUTOGROUP)!r}).read() if os.path.exists({str(AUTOGROUP)!r}) else "")
"""


def test_a_process_that_gives_way_is_nice_and_so_is_its_session() -> None:
    command = [sys.executable, "-c", SCRIPT]
    before = int(subprocess.run(["nice"], capture_output=True, check=True, text=True).stdout)
    said = subprocess.run(command, start_new_session=True, capture_output=True, check=True, text=True).stdout
    own, _, session = said.partition("\n")
    assert int(own) == min(19, before + NICENESS)
    if session.strip():
        found = re.search(r"nice (-?\d+)", session)
        assert found is not None
        assert int(found[1]) == NICENESS
