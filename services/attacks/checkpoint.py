"""Saves a running attack to one safetensors file, replaced atomically, and loads it again."""

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from services import atomic_write
from services.attacks.method import Method
from services.attacks.problem import AttackProblem
from services.attacks.state import AttackState
from services.attacks.trace import TraceRow
from services.attacks.verifier import Verifier
from services.rendering.protocol import Parameters

EVERY = 2.0
"""Seconds between checkpoints."""
COUNTS = 5
"""Counts that a checkpoint keeps."""
_WORDS = "step restart began settings below_noise seconds stopped fooled verified stored_step sampled_error"
_PLAIN = tuple(_WORDS.split())
_BACKENDS = "backends"


def save(path: Path, run: AttackState, problem: AttackProblem, method: Method, verifier: Verifier) -> None:
    """Writes the loop's state, the method's state, and the query and render counts of `problem` and `verifier`."""
    tensors = {f"method.{name}": value for name, value in method.state().items()}
    tensors |= {f"stored.{group}": value for group, value in run.stored.items()}
    tensors |= {"ever": run.ever, "image": run.image, "scores": run.scores}
    words = {name: getattr(run, name) for name in _PLAIN}
    words["trace"] = [row.model_dump() for row in run.trace]
    words["counts"] = [
        problem.queries,
        problem.renders,
        problem.surrogate_queries,
        verifier.queries,
        verifier.renders,
    ]
    words[_BACKENDS] = _backends(problem, verifier)
    with atomic_write.replacing(path) as part:
        # safetensors saves no two tensors that share memory, as a method's may
        save_file(
            {name: value.detach().clone(memory_format=torch.contiguous_format) for name, value in tensors.items()},
            part,
            {"run": json.dumps(words)},
        )


def load(path: Path | None, problem: AttackProblem, method: Method, verifier: Verifier) -> AttackState | None:
    """Returns the saved state of the loop, or None if `path` is None, missing, damaged, of an earlier version, or of
    other backends: a machine whose images differ in their last bits does not go on where another one stopped.

    Also loads the method's state into `method`, and the counts into `problem` and `verifier`. After None the attack
    starts again and ends in the same result.
    """
    if path is None or not path.exists():
        return None
    try:
        with safe_open(path, "pt") as file:
            words = _words(file)
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
    except (SafetensorError, KeyError, ValueError, OSError):
        return None
    if not words.keys() >= {*_PLAIN, _BACKENDS} or len(words["counts"]) != COUNTS:  # an earlier version's
        return None
    if words[_BACKENDS] != _backends(problem, verifier):
        return None
    run = AttackState(**{name: words[name] for name in _PLAIN})
    assert {field.name for field in fields(run)} == {*_PLAIN, "trace", "ever", "stored", "image", "scores"}
    run.trace = [TraceRow(**row) for row in words["trace"]]
    run.ever, run.image, run.scores = tensors["ever"], tensors["image"], tensors["scores"]
    # the file has them sorted by name; the result lists its subsets and shares in the problem's order
    run.stored = {group: tensors[f"stored.{group}"] for group in problem.groups}
    method.load({n.removeprefix("method."): v for n, v in tensors.items() if n.startswith("method.")})
    problem.queries, problem.renders, problem.surrogate_queries, *of_verifier = words["counts"]
    verifier.queries, verifier.renders = of_verifier
    return run


@dataclass(frozen=True)
class Best:
    """The perturbation that an attack would store if it ended at its checkpoint."""

    stored: Parameters
    stored_step: int
    step: int
    """The last step before the checkpoint."""
    queries: int
    """Images that the target had classified by then."""


def best(path: Path) -> Best | None:
    """The best perturbation of a checkpoint; None if there is none or it is damaged."""
    try:
        with safe_open(path, "pt") as file:
            words = _words(file)
            names = [name for name in file.keys() if name.startswith("stored.")]  # noqa: SIM118 - not a mapping
            stored = {name.removeprefix("stored."): file.get_tensor(name) for name in names}
        last = words["trace"][-1]
        return Best(stored, words["stored_step"], last["step"], last["queries"]) if stored else None
    except (SafetensorError, LookupError, ValueError, OSError):
        return None


def saved_step(path: Path) -> int:
    """The step that a checkpoint was saved at; -1 if there is none or it is damaged."""
    try:
        with safe_open(path, "pt") as file:
            return int(_words(file)["step"])
    except (SafetensorError, KeyError, ValueError, OSError):
        return -1


def _words(file: Any) -> dict[str, Any]:
    words: dict[str, Any] = json.loads((file.metadata() or {})["run"])
    return words


def _backends(problem: AttackProblem, verifier: Verifier) -> list[str]:
    return [problem.renderer.backend, verifier.renderer.backend, problem.target.backend]
