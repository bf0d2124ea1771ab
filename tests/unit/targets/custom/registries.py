"""What registering targets changes in this process, undone."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from scene_attack.targets import registry
from scene_attack.targets.architectures import ARCHITECTURES
from scene_attack.targets.info import TARGETS, UNAVAILABLE


@contextmanager
def restored(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Undoes, at the end, `monkeypatch` and what was registered, and empties the caches of targets."""
    before, architectures = TARGETS.snapshot(), ARCHITECTURES.snapshot()
    yield
    monkeypatch.undo()
    TARGETS.restore(before)
    ARCHITECTURES.restore(architectures)
    UNAVAILABLE.clear()
    registry.load.cache_clear()
    registry.has_gradient.cache_clear()
