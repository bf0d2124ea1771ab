"""The thread in which the library draws and attacks, whoever calls it: OpenGL belongs to one thread of a process.

What several threads ask for is done one after the other, so that it has the results that it has alone.
"""

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import torch

from scene_attack.errors import JobFailure
from scene_attack.rendering.opengl import context

Answer = TypeVar("Answer")
_here = threading.local()
_thread = ThreadPoolExecutor(1, "scene-attack", initializer=lambda: setattr(_here, "owns", True))
_process: int | None = None
"""The process that has the thread; None before it was used."""


def run(work: Callable[[Callable[[], bool]], Answer]) -> Answer:
    """Returns the answer of `work`, which runs in the owner thread; an error is raised here.

    `work` gets a function that says whether the caller has been interrupted, as by Ctrl-C: it then has to end, and is
    waited for. A program that has used OpenGL in this thread already, as a command does, works in it. Raises
    JobFailure("internal") in a process that was forked after the thread had been used: it has no such thread.
    """
    global _process
    if hasattr(_here, "owns") or context.owner() == threading.get_ident():
        return work(lambda: False)
    if _process not in (None, os.getpid()):
        detail = (
            "scene_attack was used before this process was forked: start it by multiprocessing's method spawn instead"
        )
        raise JobFailure("internal", detail)
    _process = os.getpid()
    interrupted = threading.Event()
    gradients = torch.is_grad_enabled()

    def task() -> Answer:
        with torch.set_grad_enabled(gradients):  # each thread has a mode of its own
            return work(interrupted.is_set)

    future = _thread.submit(task)
    try:
        return future.result()
    except BaseException:
        interrupted.set()
        future.exception()
        raise


class Owned:
    """A renderer that renders in the owner thread; the rest is the renderer's own."""

    def __init__(self, renderer: Any, request: dict[str, Any]) -> None:
        self._renderer = renderer
        self.request = request
        """What a request has of it: its scene, its tolerance, and the attack's renderer and groups."""

    def render(self, parameters: dict[str, torch.Tensor]) -> torch.Tensor:
        """As the renderer does."""
        images: torch.Tensor = run(lambda _: self._renderer.render(parameters))
        return images

    def exact(self) -> "Owned":
        """The renderer without approximations."""
        return Owned(run(lambda _: self._renderer.exact()), {**self.request, "tolerance": "exact"})

    def reseeded(self, number: int) -> "Owned | None":
        """The renderer with other random numbers; None if its images have no noise."""
        other = self._renderer.reseeded(number)
        return None if other is None else Owned(other, self.request)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._renderer, name)
