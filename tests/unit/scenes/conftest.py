"""A library on the real catalogue, with a place of its own for what it derives from it."""

import pytest

from scene_attack.scenes.library import Library
from scene_attack_service.settings import Settings


@pytest.fixture(scope="session")
def assets(tmp_path_factory):
    """A cache directory with the installed archives and maps, and nothing processed yet."""
    cache = tmp_path_factory.mktemp("cache")
    for name in ("furniture", "environments"):
        source = Settings().cache_dir / name
        if not source.is_dir():
            pytest.fail(f"there is no {source}; run `scene-attack assets fetch` first")
        (cache / name).symlink_to(source)
    return cache


@pytest.fixture(scope="session")
def library(assets, tmp_path_factory):
    return Library(assets, tmp_path_factory.mktemp("data"))
