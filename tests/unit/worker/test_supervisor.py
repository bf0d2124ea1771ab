import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from scene_attack_worker import supervisor as module
from scene_attack_worker.supervisor import Program, Supervisor

pytestmark = pytest.mark.slow


class Scenario:
    """A duty that looks, each time, whether what is waited for has come about, and ends the supervisor when it has."""

    def __init__(self) -> None:
        self.supervisor: Supervisor | None = None
        self.deadline = time.monotonic() + 30

    def __call__(self) -> None:
        assert time.monotonic() < self.deadline, "what was waited for did not happen"
        if self.done() and self.supervisor is not None:
            self.supervisor.stop()

    def done(self) -> bool:
        raise NotImplementedError

    def run(self, *programs: Program) -> None:
        self.supervisor = Supervisor(programs, self)
        handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
        try:
            self.supervisor.run()
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)


@pytest.fixture(autouse=True)
def _no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "TICK_SECONDS", 0.0)
    monkeypatch.setattr(module, "POLL_SECONDS", 0.01)


def program(name: str, script: str, **options: object) -> Program:
    return Program(name, lambda: [sys.executable, "-c", script], **options)  # type: ignore[arg-type]


def test_what_ends_is_started_again_and_its_end_is_told(tmp_path: Path) -> None:
    ends: list[int] = []
    starts = tmp_path / "starts"
    one = program("one", f"open({str(starts)!r}, 'a').write('x')", ended=lambda: ends.append(1))

    class Twice(Scenario):
        def done(self) -> bool:
            return len(ends) >= 2

    Twice().run(one)
    assert len(starts.read_text()) >= 2


def test_all_are_stopped_together_and_the_last_ones_last(tmp_path: Path) -> None:
    log = tmp_path / "log"
    script = (
        "import signal, sys\n"
        "def stop(*_):\n"
        "    open({log!r}, 'a').write({name!r}); sys.exit(0)\n"
        "signal.signal(signal.SIGTERM, stop)\n"
        "open({log!r} + {name!r}, 'w').close()\n"
        "signal.pause()\n"
    )
    names = ("r", "a", "b")
    programs = [program(n, script.format(log=str(log), name=n), last=n == "r") for n in names]

    class Started(Scenario):
        def done(self) -> bool:
            return all(Path(f"{log}{n}").exists() for n in names)

    Started().run(*programs)
    assert log.read_text()[-1] == "r"
    assert sorted(log.read_text()) == ["a", "b", "r"]


def test_what_does_not_stop_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "STOP_SECONDS", 0.1)
    mark = tmp_path / "mark"
    script = (
        "import signal\n"
        "signal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
        f"open({str(mark)!r}, 'w').close()\n"
        "while True: signal.pause()\n"
    )
    deaf = program("deaf", script)

    class Started(Scenario):
        def done(self) -> bool:
            return mark.exists()

    Started().run(deaf)
    assert deaf.process is not None
    assert deaf.process.returncode == -signal.SIGKILL


def test_what_hangs_is_killed_and_started_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "ASK_SECONDS", 0.0)
    script = """
import os, signal
from scene_attack_service.jobs import processes
processes.say_alive()
os.kill(os.getpid(), signal.SIGSTOP)
"""
    ends: list[int] = []
    hung = program("hung", script, ended=lambda: ends.append(1), silent_seconds=0.0)

    class Twice(Scenario):
        def done(self) -> bool:
            return len(ends) == 2

    Twice().run(hung)


def test_what_answers_is_left_alone_and_what_starts_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "ASK_SECONDS", 0.0)
    asked: list[int] = []
    ends: list[int] = []

    def answers() -> bool:
        asked.append(1)
        return True

    script = "import signal; signal.pause()"
    steady = program("steady", script, answers=answers, ended=lambda: ends.append(1), silent_seconds=0.0)
    starting = program("starting", script, ended=lambda: ends.append(1), silent_seconds=0.0)

    class Asked(Scenario):
        def done(self) -> bool:
            return len(asked) >= 20 and not ends

    Asked().run(steady, starting)


def test_what_never_answers_is_killed_and_started_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "ASK_SECONDS", 0.0)
    ends: list[int] = []
    silent = program("silent", "import signal; signal.pause()", answers=lambda: False, ended=lambda: ends.append(1))
    silent.silent_seconds = 0.0

    class Twice(Scenario):
        def done(self) -> bool:
            return len(ends) == 2

    Twice().run(silent)


def test_a_signal_ends_the_supervisor() -> None:
    class Signalled(Scenario):
        def done(self) -> bool:
            os.kill(os.getpid(), signal.SIGTERM)
            return False

    Signalled().run(program("one", "import signal; signal.pause()"))


def test_no_program_outlives_a_supervisor_that_is_killed() -> None:
    script = """
from scene_attack.logs import configure
from scene_attack_worker.supervisor import Program, Supervisor
configure("test")  # logs go to stderr
program = Program("one", lambda: ["sleep", "600"])
Supervisor([program], lambda: print(program.process.pid, flush=True)).run()
"""
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as supervisor:
        assert supervisor.stdout is not None
        program = psutil.Process(int(supervisor.stdout.readline()))
        supervisor.kill()
    psutil.wait_procs([program], timeout=10)
    assert not program.is_running() or program.status() == psutil.STATUS_ZOMBIE
