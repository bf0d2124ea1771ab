"""Runs a whole service as a child process: starts it, waits until it is ready, stops it."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from services.confinement.system_calls import die_with_parent
from services.errors import JobFailure

STOP_SECONDS = 30.0


@contextmanager
def running_service(data: Path, environ: dict[str, str]) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """Starts `scene-attack serve` with the data directory `data` and the environment variables `environ`.

    Gives its URL and its process once it takes jobs. Its log is `data`/service.log. The service is stopped on leaving,
    also by SIGTERM or SIGINT. Raises JobFailure("internal") if it ends before it is ready.
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    # A shell without job control starts background processes with SIGINT ignored, and Python then leaves it ignored.
    # The service has to be stopped in order, so this process handles the signal, as `serve` does.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    data.mkdir(parents=True, exist_ok=True)
    log = data / "service.log"
    with log.open("ab") as errors:
        process = subprocess.Popen(
            [sys.executable, "-m", "client", "serve"],
            env=os.environ | environ | {"SCENE_ATTACK_DATA": str(data)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            start_new_session=True,  # Ctrl-C then reaches this process alone, which stops the service
            preexec_fn=die_with_parent,  # safe: there is one thread; it ends the service if this process is killed
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
