from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from services.pipeline.target_folders import TargetFolder, register_folders
from services.settings import settings
from services.targets.architectures import register_architecture
from tests.unit.targets.custom.registries import restored
from tests.unit.targets.custom.small_network import SmallNetwork

Scan = Callable[..., tuple[TargetFolder, ...]]


@pytest.fixture
def scan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scan]:
    """Registers the folders of a directory, the test's own by default, for one test, under the given settings.

    The small network is a registered architecture then.
    """

    def run(root: Path = tmp_path, **values: str) -> tuple[TargetFolder, ...]:
        for name, value in values.items():
            monkeypatch.setenv(f"SCENE_ATTACK_{name.upper()}", value)
        settings.cache_clear()
        return register_folders(root)

    with restored(monkeypatch):
        register_architecture("small")(SmallNetwork)
        yield run
