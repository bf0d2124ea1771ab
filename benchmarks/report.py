"""Functions of all benchmarks: the shortest time of several runs, and a result file with its provenance."""

import json
import platform
import shlex
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.stale import DEPENDS, ROOT
from scene_attack.process import versions

RESULTS = Path(__file__).parent / "results"
VERSIONED = ("scene-attack", "torch", "numpy", "pyrender-maintained")


def shortest(work: Callable[[], object], repeats: int, warm_up: int = 2) -> float:
    """Seconds of the shortest of `repeats` runs, after `warm_up` runs that are not measured."""
    for _ in range(warm_up):
        work()
    return min(_seconds(work) for _ in range(repeats))


def _seconds(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def command() -> str:
    """The command line that reproduces this result, without the path of its file."""
    words = list(sys.argv[1:])
    if "--out" in words:
        del words[words.index("--out") : words.index("--out") + 2]
    program = Path(sys.argv[0])
    module = program.parent.name if program.stem == "__main__" else program.stem
    return shlex.join(["python", "-m", f"benchmarks.{module}", *words])


def head(about: str, backend: str, seed: int | None) -> dict[str, object]:
    """The provenance of a result: the command, the seed, the machine, the versions and the backend."""
    return {
        "about": about,
        "command": command(),
        "seed": seed,
        "machine": platform.platform(),
        "versions": versions(*VERSIONED),
        "backend": backend,
    }


def save(path: Path, about: str, backend: str, seed: int | None, **content: object) -> None:
    """Writes a result as JSON, with its provenance. Signs it (`benchmarks.stale`) if it is one that is committed."""
    path.write_text(json.dumps(head(about, backend, seed) | content, indent=1) + "\n", "utf-8")
    if any(path.resolve() == ROOT / name for name in DEPENDS):
        subprocess.run([sys.executable, "-m", "benchmarks.stale", "sign", str(path)], check=True)
    print(f"written to {path}")
