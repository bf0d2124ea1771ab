from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from scene_attack.runs.set_up import TargetFolder, register_folders
from scene_attack.targets.architectures import register_architecture
from scene_attack.targets.custom.card import AllowList
from scene_attack_service.settings import Settings
from tests.unit.targets.custom.registries import restored
from tests.unit.targets.custom.small_network import SmallNetwork

Scan = Callable[..., tuple[TargetFolder, ...]]


@pytest.fixture
def scan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scan]:
    """Registers the folders of a directory, the test's own by default, for one test, under the given settings.

    The small network is a registered architecture then.
    """

    def run(root: Path = tmp_path, **values: str) -> tuple[TargetFolder, ...]:
        return register_folders(root, AllowList.of(Settings.model_validate(values)))

    with restored(monkeypatch):
        register_architecture("small")(SmallNetwork)
        yield run
