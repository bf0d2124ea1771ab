from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import torch

from client.clevr_iep import write
from services.pipeline.target_folders import register_folders
from services.targets import registry
from services.targets.iep_released.target import ReleasedIepTarget
from tests.unit.targets.custom.registries import restored
from tests.unit.targets.iep_released import published


@dataclass(frozen=True)
class Published:
    """What was published: files in `folder`, and what is in them."""

    folder: Path
    trunk: dict[str, torch.Tensor]
    engine: dict[str, Any]
    generator: dict[str, Any]

    def converted(self, out: Path, **other: Path) -> Path:
        files = {name: self.folder / f"{name}.pt" for name in ("engine", "generator", "trunk")}
        return write(**(files | other), out=out, any_trunk=True)


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Published:
    """Files as they were written in 2017, of which the trunk's is as of today."""
    folder = tmp_path_factory.mktemp("published")
    found = Published(folder, published.trunk(), published.engine(), published.generator())
    torch.save(found.trunk, folder / "trunk.pt")
    published.save_as_in_2017(found.engine, folder / "engine.pt")
    published.save_as_in_2017(found.generator, folder / "generator.pt")
    return found


@pytest.fixture(scope="session")
def root(made: Published, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of networks, of which "released" is the converted one."""
    folder = tmp_path_factory.mktemp("targets")
    made.converted(folder / "released")
    return folder


@pytest.fixture
def target(root: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ReleasedIepTarget]:
    """The converted network as a registered target."""
    with restored(monkeypatch):
        (folder,) = register_folders(root)
        assert folder.error is None
        found = registry.load("released")
        assert isinstance(found, ReleasedIepTarget)
        yield found
