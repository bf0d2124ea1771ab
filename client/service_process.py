"""A whole service of one's own, as a child process: started, waited for, stopped."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from services.errors import JobFailure
from services.jobs.parent_death import die_with_parent

STOP_SECONDS = 30.0


@contextmanager
def running_service(data: Path, environ: dict[str, str]) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """Starts `scene-attack serve` on the data directory with these settings; gives its address once it takes jobs.

    Its log is `data`/service.log. It is stopped on leaving, also when that is by SIGTERM or SIGINT. Raises
    JobFailure("internal") if it ends before it is ready.
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    # A shell without job control starts what runs in the background with SIGINT ignored, and Python then leaves it
    # ignored. We own a service that has to be stopped in order, so we take the signal as `serve` does.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    data.mkdir(parents=True, exist_ok=True)
    log = data / "service.log"
    with log.open("ab") as errors:
        process = subprocess.Popen(
            [sys.executable, "-m", "worker.stack"],
            env=os.environ | environ | {"SCENE_ATTACK_DATA": str(data)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            start_new_session=True,  # Ctrl-C reaches us alone; we stop it
            preexec_fn=die_with_parent,  # safe: there is one thread; for when we are killed and cannot
        )
    assert process.stdout is not None
    try:
        word, _, url = process.stdout.readline().strip().partition(" ")
        if word != "ready":
            raise JobFailure("internal", f"the service did not start; its log: {log}")
        yield url, process
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(STOP_SECONDS)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        process.stdout.close()
