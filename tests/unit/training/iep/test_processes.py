import operator
import os
import signal
import subprocess
import sys
import time
from contextlib import closing

import psutil
import pytest

from scene_attack.errors import JobFailure
from tests.processes import command_line
from tests.unit.training.iep.small import After, never
from training.iep.processes import each

pytestmark = pytest.mark.slow

SLEEP = """import signal, time
from training.iep.processes import each
signal.signal(signal.SIGINT, signal.default_int_handler)  # the tests may have been begun in the background, without it
list(each(time.sleep, [600, 600], 2, bool))"""


def children(of: psutil.Process) -> list[psutil.Process]:
    """The processes of a pool; the tracker that multiprocessing starts beside them is none."""
    return [one for one in of.children(recursive=True) if "spawn_main" in " ".join(command_line(one))]


@pytest.mark.parametrize("processes", [1, 2])
def test_each_item_has_its_result_and_none_begins_once_it_is_over(processes: int) -> None:
    assert dict(each(operator.neg, range(6), processes, After(4))) == {k: -k for k in range(4)}
    assert children(psutil.Process()) == []


def test_a_process_has_one_thread_and_its_errors_are_raised_here() -> None:
    said = ["__import__('torch').get_num_threads()", "int(__import__('os').environ['LP_NUM_THREADS'])", "[][1]"]
    assert [threads for _, threads in each(eval, said[:2], 2, never)] == [1, 1]
    with pytest.raises(IndexError):
        list(each(eval, said[1:], 2, never))
    assert children(psutil.Process()) == []


def test_a_killed_process_is_an_error() -> None:
    with pytest.raises(JobFailure, match="one of 2 processes was killed"):
        list(each(os._exit, [3, 3], 2, never))
    assert children(psutil.Process()) == []


def test_processes_end_when_the_iterator_is_closed() -> None:
    with closing(each(time.sleep, [0, 600, 600], 2, never)) as made:
        assert next(made) == (0, None)
        assert children(psutil.Process())
    assert children(psutil.Process()) == []


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_processes_end_with_their_parent(number: signal.Signals) -> None:
    with subprocess.Popen([sys.executable, "-c", SLEEP], stderr=subprocess.DEVNULL) as parent:
        try:
            deadline = time.monotonic() + 120
            while len(started := children(psutil.Process(parent.pid))) < 2:
                assert parent.poll() is None, "it ended before its processes were there"
                assert time.monotonic() < deadline
                os.sched_yield()
            parent.send_signal(number)
            parent.wait(60)
        finally:
            parent.kill()
        assert not psutil.wait_procs(started, timeout=60)[1]
