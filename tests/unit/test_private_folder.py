import os
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from services.jobs.database import connect, migrate
from services.private_folder import make_private
from services.settings import Settings


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.fixture(autouse=True)
def _permissive() -> Iterator[None]:
    """What others may do is not left to the user's umask."""
    before = os.umask(0o000)
    yield
    os.umask(before)


def test_a_new_folder_is_private_and_its_parents_are_as_others(tmp_path: Path) -> None:
    make_private(tmp_path / "a" / "b")
    assert (mode(tmp_path / "a" / "b"), mode(tmp_path / "a")) == (0o700, 0o777)


@pytest.mark.parametrize(("before", "after"), [(0o755, 0o700), (0o770, 0o700), (0o500, 0o500), (0o1777, 0o1777)])
def test_a_folder_of_ours_is_made_private_unless_all_share_it(tmp_path: Path, before: int, after: int) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    folder.chmod(before)
    make_private(folder)
    assert mode(folder) == after


def test_another_users_folder_stays_as_it_is(tmp_path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root can give a folder to another user")
    folder = tmp_path / "data"
    folder.mkdir(mode=0o755)
    os.chown(folder, 65534, 65534)
    make_private(folder)
    assert mode(folder) == 0o755


def test_the_data_folder_is_private(tmp_path: Path) -> None:
    data = tmp_path / "data"
    data.mkdir(mode=0o755)
    engine = connect(Settings(data=data))
    migrate(engine, Settings(data=data))
    engine.dispose()
    assert mode(data) == 0o700
