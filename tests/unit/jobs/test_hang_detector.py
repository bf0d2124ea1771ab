import os
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest

from services.jobs.processes import LONGEST_GAP, SIGN_SECONDS, HangDetector, processor_seconds

pytestmark = pytest.mark.slow

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
        use(spinning.pid, SIGN_SECONDS)
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
