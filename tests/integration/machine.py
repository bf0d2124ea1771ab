"""A user's machine, on which commands run as processes of their own."""

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from scene_attack_service.settings import Settings
from tests.integration.conftest import PATIENCE


class Machine:
    """A user's machine: HOME is a folder, the cache is filled, and nothing else of the tests' environment is set."""

    def __init__(self, home: Path, **environ: str) -> None:
        kept = {name: value for name, value in os.environ.items() if not name.startswith("SCENE_ATTACK_")}
        self._environ = kept | {"HOME": str(home), "SCENE_ATTACK_CACHE": str(Settings().cache_dir)} | environ

    def popen(self, *arguments: str, **options: Any) -> "subprocess.Popen[str]":
        command = [sys.executable, "-m", "scene_attack", *arguments]
        return subprocess.Popen(command, env=self._environ, text=True, stderr=subprocess.PIPE, **options)

    def run(self, *arguments: str) -> tuple[int, str, str]:
        with self.popen(*arguments, stdout=subprocess.PIPE) as process:
            stdout, stderr = process.communicate(timeout=PATIENCE)
            return process.returncode, stdout, stderr

    def json(self, *arguments: str) -> Any:
        code, stdout, stderr = self.run(*arguments, "--json")
        assert code == 0, stderr
        return json.loads(stdout)

    @contextmanager
    def logging(self, *arguments: str) -> Iterator["Iterator[dict[str, Any]]"]:
        """Starts a part of the service; gives the lines of its log, and ends it."""
        with self.popen(*arguments, stdout=subprocess.DEVNULL) as process:
            timer = threading.Timer(PATIENCE, process.kill)  # so that waiting for a line ends
            timer.start()
            try:
                assert process.stderr is not None
                yield (json.loads(line) for line in process.stderr if line.startswith("{"))
            finally:
                process.send_signal(signal.SIGTERM)
                process.communicate()
                timer.cancel()
