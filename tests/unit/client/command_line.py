"""Runs the command line: `cli` in this process, which has imported everything, `process` in one of its own."""

import gc
import io
import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from typing import NamedTuple
from unittest.mock import patch

from scene_attack.__main__ import main
from scene_attack.process import ALLOCATOR


class Done(NamedTuple):
    """What a command came to, as `subprocess.CompletedProcess` has it."""

    returncode: int
    stdout: str
    stderr: str


def cli(*arguments: str, stdin: str = "", **environ: str) -> Done:
    """Runs a command without a process: its code is imported already, so that it takes its own time alone.

    The settings that a process chooses once (scene_attack.process) cannot be given; `process` takes them.
    """
    out, err, code = io.StringIO(), io.StringIO(), 0
    with (
        patch.dict(os.environ, ALLOCATOR | environ),  # with the allocator's settings `run` does not start itself again
        patch.object(sys, "argv", ["scene-attack", *arguments]),
        patch.object(sys, "stdin", io.StringIO(stdin)),
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
        finally:
            gc.unfreeze()  # a command freezes what it has imported
    return Done(code, out.getvalue(), err.getvalue())


def process(*arguments: str, stdin: str = "", **environ: str) -> Done:
    """Runs a command as a process."""
    done = subprocess.run(
        [sys.executable, "-m", "scene_attack", *arguments],
        input=stdin,
        capture_output=True,
        text=True,
        env=os.environ | environ,
        check=False,
        timeout=120,
    )
    return Done(done.returncode, done.stdout, done.stderr)
