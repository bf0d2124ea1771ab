from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from services.pipeline.target_folders import TargetFolder, register_folders
from services.settings import settings
from services.targets import registry
from services.targets.architectures import ARCHITECTURES, register_architecture
from services.targets.info import TARGETS, UNAVAILABLE
from tests.unit.targets.custom.small_network import SmallNetwork

Scan = Callable[..., tuple[TargetFolder, ...]]


@pytest.fixture
def scan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scan]:
    """Registers the folders of a directory, the test's own by default, for one test, under the given settings.

    The small network is a registered architecture then.
    """
    before, architectures = TARGETS.snapshot(), ARCHITECTURES.snapshot()
    register_architecture("small")(SmallNetwork)

    def run(root: Path = tmp_path, **values: str) -> tuple[TargetFolder, ...]:
        for name, value in values.items():
            monkeypatch.setenv(f"SCENE_ATTACK_{name.upper()}", value)
        settings.cache_clear()
        return register_folders(root)

    yield run
    monkeypatch.undo()
    settings.cache_clear()
    TARGETS.restore(before)
    ARCHITECTURES.restore(architectures)
    UNAVAILABLE.clear()
    registry.load.cache_clear()
    registry.has_gradient.cache_clear()
