"""Computes in several processes of one thread each, which never outlive this one.

They are spawned, because a fork hangs after its parent has used OpenGL or torch. Each reads a pipe that nothing is
written to: the pipe ends when this process closes it or dies, however it dies, and the process then ends at once.
"""

import os
import signal
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from itertools import islice
from multiprocessing import get_context
from multiprocessing.connection import Connection
from threading import Thread
from typing import TypeVar

from scene_attack.errors import JobFailure
from scene_attack.options import Options
from scene_attack.process import use

T = TypeVar("T")
R = TypeVar("R")


def cores() -> int:
    """Returns the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0))


def each(
    function: Callable[[T], R], items: Sequence[T], processes: int, over: Callable[[], bool]
) -> Generator[tuple[T, R], None, None]:
    """Yields each item with its result as soon as that is there; begins no further item once it is `over`.

    Of two processes and more, each computes one item at a time; `function`, items and results are pickled. Close the
    iterator to end them early. Raises JobFailure("worker-lost") if one of them dies, and the errors of `function`.
    """
    count = min(processes, len(items))
    if count < 2:
        for item in items:
            if over():
                return
            yield item, function(item)
        return
    try:
        with _pool(count) as pool:
            yield from _in(pool, count, function, iter(items), over)
    except BrokenProcessPool as error:
        raise JobFailure("worker-lost", f"one of {count} processes was killed; perhaps memory ran out") from error


def _in(
    pool: ProcessPoolExecutor, count: int, function: Callable[[T], R], items: Iterator[T], over: Callable[[], bool]
) -> Iterator[tuple[T, R]]:
    running: dict[Future[R], T] = {}
    while True:
        for item in islice(items, count - len(running)):
            if over():
                items = iter(())
                break
            running[pool.submit(function, item)] = item
        if not running:
            return
        for done in wait(running, return_when=FIRST_COMPLETED).done:
            yield running.pop(done), done.result()


@contextmanager
def _pool(count: int) -> Iterator[ProcessPoolExecutor]:
    """A pool whose processes end at once when the block raises or is left by closing the iterator."""
    context = get_context("spawn")
    theirs, ours = context.Pipe(duplex=False)
    with theirs, ours, ProcessPoolExecutor(count, context, _prepare, (theirs,)) as pool:
        try:
            yield pool
        except BaseException:
            ours.close()
            raise


def _prepare(parent: Connection) -> None:
    """Prepares a process of a pool: it ends with its parent, leaves Ctrl-C to it, has the options of the environment,
    and uses one thread.
    """
    Thread(target=_end_with, args=(parent,), daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ |= {"OMP_NUM_THREADS": "1", "LP_NUM_THREADS": "1"}  # the second is that of OpenGL in software
    use(Options.of_environment())
    import torch

    torch.set_num_threads(1)


def _end_with(parent: Connection) -> None:
    with suppress(EOFError, OSError):
        parent.recv_bytes()
    os._exit(1)
