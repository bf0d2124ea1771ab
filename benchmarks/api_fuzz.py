"""Sends generated requests to a running API and compares its answers with its own description.

`python -m benchmarks.api_fuzz --examples 200` sends some 5,000 requests, in about five minutes on two cores. The API
runs as it does in service, as a process with a database, Redis and a key; there is no worker, so jobs stay queued. The
exit code is 1 if schemathesis found a violation, or if the log has a mistake of the service.
"""

import argparse
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx

from scene_attack_service.settings import Settings
from scene_attack_worker.stack import EmbeddedRedis

CONFIG = Path(__file__).with_suffix(".toml")
START_SECONDS = 120.0


@dataclass(frozen=True)
class Server:
    """A running API: its address, a key with all scopes, its process id and the file of its log."""

    url: str
    key: str
    pid: int
    log: Path

    def memory(self) -> float:
        """Resident memory in MB."""
        status = Path(f"/proc/{self.pid}/status").read_text().splitlines()
        return next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmRSS"))

    def mistakes(self) -> list[str]:
        """The lines of the log about requests that the service answered by 500."""
        return [line for line in self.log.read_text().splitlines() if '"request failed"' in line]


@contextmanager
def served(folder: Path) -> Iterator[Server]:
    """Runs the API and Redis with their files in a folder."""
    redis = EmbeddedRedis()
    options = {"data": folder / "data", "redis_url": redis.url, "max_queued": 100_000}
    environ = os.environ | Settings.model_validate(options).environ()
    command = [sys.executable, "-m", "scene_attack", "keys", "create", "fuzz", "--scope", "admin", "--json"]
    key = json.loads(subprocess.run(command, env=environ, capture_output=True, check=True).stdout)["key"]
    log = folder / "api.log"
    with socket.create_server(("127.0.0.1", 0)) as listener, log.open("w") as log_file:
        url = f"http://127.0.0.1:{listener.getsockname()[1]}"
        programs = [
            subprocess.Popen(redis.program().command(), stdout=subprocess.DEVNULL),
            subprocess.Popen(
                [sys.executable, "-m", "scene_attack_api.main", str(listener.fileno())],
                env=environ,
                pass_fds=[listener.fileno()],
                stderr=log_file,
            ),
        ]
        try:
            _wait_for(url)
            yield Server(url, key, programs[1].pid, log)
        finally:
            for program in reversed(programs):
                program.send_signal(signal.SIGTERM)
                program.wait()
            redis.remove()


def _wait_for(url: str) -> None:
    deadline = time.monotonic() + START_SECONDS
    while True:
        try:
            httpx.get(f"{url}/healthz", timeout=5).raise_for_status()
        except httpx.HTTPError:
            if time.monotonic() > deadline:
                raise
        else:
            return


def fuzz(server: Server, examples: int, seed: int) -> subprocess.CompletedProcess[str]:
    """Runs schemathesis with at most `examples` requests for each operation."""
    command = [
        *(sys.executable, "-m", "schemathesis.cli", "--config-file", str(CONFIG), "--no-color"),
        *("run", f"{server.url}/openapi.json", "--header", f"Authorization: Bearer {server.key}"),
        *("--phases", "fuzzing", "--max-examples", str(examples), "--seed", str(seed), "--continue-on-failure"),
        *("--request-timeout", "60", "--suppress-health-check", "all", "--warnings", "off"),
        *("--generation-database", "none"),
    ]
    # It keeps files where it runs.
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=server.log.parent)


def main() -> int:
    """Prints what schemathesis says, the memory of the API before and after, and mistakes in its log."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--examples", type=int, default=200, help="largest number of requests for each operation")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, served(Path(folder)) as server:
        before = server.memory()
        done = fuzz(server, options.examples, options.seed)
        print(done.stdout, done.stderr, sep="\n")
        print(f"resident memory of the API: {before:.0f} MB before, {server.memory():.0f} MB after")
        print(*server.mistakes(), sep="\n")
        return int(done.returncode != 0 or bool(server.mistakes()))


if __name__ == "__main__":
    sys.exit(main())
