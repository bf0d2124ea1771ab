import os
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from scene_attack.disk import NotOurs, make_private
from scene_attack.errors import InvalidRequest
from scene_attack_service.jobs.database import connect, migrate
from scene_attack_service.settings import Settings

OURS = frozenset({"jobs.sqlite"})


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.fixture(autouse=True)
def _permissive() -> Iterator[None]:
    """What others may do is not left to the user's umask."""
    before = os.umask(0o000)
    yield
    os.umask(before)


def test_a_new_folder_is_private_and_its_parents_are_as_others(tmp_path: Path) -> None:
    make_private(tmp_path / "a" / "b", OURS)
    assert (mode(tmp_path / "a" / "b"), mode(tmp_path / "a")) == (0o700, 0o777)


@pytest.mark.parametrize(("before", "after"), [(0o755, 0o700), (0o770, 0o700), (0o500, 0o500), (0o1777, 0o1777)])
def test_a_folder_of_ours_is_made_private_unless_all_share_it(tmp_path: Path, before: int, after: int) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    folder.chmod(before)
    make_private(folder, OURS)
    assert mode(folder) == after


def test_another_users_folder_stays_as_it_is(tmp_path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root can give a folder to another user")
    folder = tmp_path / "data"
    folder.mkdir(mode=0o755)
    os.chown(folder, 65534, 65534)
    make_private(folder, OURS)
    assert mode(folder) == 0o755


def test_the_data_folder_is_private(tmp_path: Path) -> None:
    data = tmp_path / "data"
    data.mkdir(mode=0o755)
    engine = connect(Settings(data=data))
    migrate(engine, Settings(data=data))
    engine.dispose()
    assert mode(data) == 0o700


def test_a_folder_with_other_things_is_not_closed_to_those_who_use_it(tmp_path: Path) -> None:
    folder = tmp_path / "home"
    folder.mkdir()
    folder.chmod(0o755)
    for name in (".cache", "lost+found", "jobs.sqlite"):
        (folder / name).touch()
    (folder / "thesis.tex").touch()
    with pytest.raises(NotOurs, match=r"thesis\.tex"):
        make_private(folder, OURS)
    assert mode(folder) == 0o755
    (folder / "thesis.tex").unlink()
    make_private(folder, OURS)
    assert mode(folder) == 0o700


def test_a_data_folder_with_other_things_or_that_cannot_be_is_named(tmp_path: Path) -> None:
    (tmp_path / "home").mkdir(mode=0o755)
    (tmp_path / "home/thesis.tex").touch()
    for folder, said in ((tmp_path / "home", "thesis.tex"), (tmp_path / "home/thesis.tex", "cannot be made")):
        with pytest.raises(InvalidRequest, match=said) as error:
            connect(Settings(data=folder))
        assert error.value.field == "SCENE_ATTACK_DATA"


def test_a_data_folder_that_was_used_by_all_before_is_ours(tmp_path: Path) -> None:
    data = tmp_path / "data"
    values = Settings(data=data)
    engine = connect(values)
    migrate(engine, values)
    with engine.connect():  # SQLite's files beside the database's are there
        for name in ("artifacts", "assets", "checkpoints", "running"):
            (data / name).mkdir()
        data.chmod(0o755)
        connect(values).dispose()
    engine.dispose()
    assert mode(data) == 0o700
