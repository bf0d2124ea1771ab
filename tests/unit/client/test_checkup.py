import json
import sqlite3
from pathlib import Path

import pytest
from typer.testing import CliRunner

from scene_attack.blobs import blobs
from scene_attack.cli import checkup
from scene_attack.cli.app import app
from scene_attack.cli.checkup import Finding
from scene_attack_service import checkup as of_service
from scene_attack_service.jobs.database import connect, migrate
from scene_attack_service.settings import Settings
from tests.unit.jobs.test_database import with_a_later_revision

pytestmark = pytest.mark.slow


def settings(folder: Path, **given: object) -> Settings:
    return Settings.model_validate({"data": folder / "data", "cache": folder / "cache", **given})


def only(found: list[Finding]) -> Finding:
    [one] = found
    return one


def made(folder: Path) -> Settings:
    values = settings(folder)
    engine = connect(values)
    migrate(engine, values)
    engine.dispose()
    return values


def test_a_fresh_installation_has_what_it_needs(tmp_path: Path) -> None:
    values = settings(tmp_path)
    for check in (checkup.packages, checkup.cache, of_service.data, of_service.database, of_service.redis):
        for one in check(values):
            assert one.level == "ok", one
    assert not (tmp_path / "data").exists()


def test_a_package_that_is_missing_or_too_old_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Installed:
        requires = ("no-such-package>=1", "pytest<2", "typer>=0", 'needed-elsewhere; sys_platform == "plan9"')

    monkeypatch.setattr(checkup, "distribution", lambda _: Installed)
    found = only(list(checkup.packages(settings(tmp_path))))
    assert found.level == "fail"
    assert "no-such-package is missing; pytest is " in found.text
    assert "typer" not in found.text
    assert "elsewhere" not in found.text


def test_a_folder_that_others_may_read_or_that_is_none(tmp_path: Path) -> None:
    values = settings(tmp_path)
    values.data_dir.mkdir(mode=0o755)
    [data], [cache] = of_service.data(values), checkup.cache(values)
    assert (data.level, cache.level) == ("warn", "ok")
    assert data.remedy == f"chmod 700 {values.data_dir}"
    values.data_dir.chmod(0o700)
    assert next(of_service.data(values)).level == "ok"
    values.data_dir.rmdir()
    values.data_dir.write_text("a file")
    assert next(of_service.data(values)).level == "fail"


@pytest.mark.parametrize(("limit", "level"), [("LITTLE_SPACE", "warn"), ("NO_SPACE", "fail")])
def test_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str, level: str) -> None:
    monkeypatch.setattr(checkup, "LITTLE_SPACE", 10**18)
    monkeypatch.setattr(checkup, limit, 10**18)
    values = settings(tmp_path)
    assert [one.level for one in (*of_service.data(values), *checkup.cache(values))] == [level, level]


@pytest.mark.parametrize("revision", ["0019", "9999"])
def test_tables_of_another_version(tmp_path: Path, revision: str) -> None:
    values = made(tmp_path)
    assert only(list(of_service.database(values))).level == "ok"
    with sqlite3.connect(values.data_dir / "jobs.sqlite") as connection:
        connection.execute("UPDATE alembic_version SET version_num = ?", [revision])
    connection.close()
    found = only(list(of_service.database(values)))
    assert (found.level, revision in found.text) == ("fail", True)


def test_tables_that_the_next_start_migrates(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = made(tmp_path)
    with_a_later_revision(tmp_path_factory.mktemp("later"), monkeypatch)
    found = only(list(of_service.database(values)))
    assert (found.level, found.text) == ("warn", "sqlite: its tables are of revision 0021, not later")


def test_a_damaged_database(tmp_path: Path) -> None:
    values = made(tmp_path)
    (values.data_dir / "jobs.sqlite").write_bytes(b"no database" * 1000)
    for file in values.data_dir.glob("jobs.sqlite-*"):
        file.unlink()
    assert only(list(of_service.database(values))).level == "fail"


def test_a_database_url_that_is_none(tmp_path: Path) -> None:
    found = only(list(of_service.database(settings(tmp_path, database_url="mysql://secret@host/name"))))
    assert found.level == "fail"
    assert "secret" not in found.text


def test_redis_that_answers_and_one_that_does_not(tmp_path: Path, redis_url: str) -> None:
    found = only(list(of_service.redis(settings(tmp_path, redis_url=redis_url))))
    assert (found.level, found.text.endswith("workers alive: 0")) == ("ok", True)
    assert only(list(of_service.redis(settings(tmp_path, redis_url="redis://127.0.0.1:1")))).level == "fail"
    assert only(list(of_service.redis(settings(tmp_path, redis_url="http://127.0.0.1:1")))).level == "fail"


def test_a_store_that_answers_and_one_that_does_not(
    tmp_path: Path, s3_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert list(of_service.store(settings(tmp_path))) == []
    there = settings(tmp_path, artifact_url=f"{s3_url}/doctor")
    assert only(list(of_service.store(there))).level == "ok"
    assert blobs(f"{s3_url}/doctor", "artifacts").names() == []
    nowhere = only(list(of_service.store(settings(tmp_path, artifact_url="s3://no-such-bucket/doctor"))))
    assert (nowhere.level, "does not answer" in nowhere.text) == ("fail", True)
    assert only(list(of_service.store(settings(tmp_path, artifact_url="nothing://bucket")))).level == "fail"
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:1")
    assert only(list(of_service.store(there))).level == "fail"
    assert only(list(checkup.meshes(there))).level == "warn"  # it needs no store


def test_a_variable_that_is_no_setting_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert list(of_service.variables(settings(tmp_path))) == []
    monkeypatch.setenv("SCENE_ATTACK_MAX_QUEUD", "3")
    monkeypatch.setenv("SCENE_ATTACK_KEY", "sa_a")
    found = only(list(of_service.variables(settings(tmp_path))))
    assert (found.subject, found.level) == ("SCENE_ATTACK_MAX_QUEUD", "warn")
    assert "did you mean 'SCENE_ATTACK_MAX_QUEUED'" in found.text


def test_meshes_that_were_not_fetched(tmp_path: Path) -> None:
    found = only(list(checkup.meshes(settings(tmp_path))))
    assert (found.level, "assets fetch" in found.remedy) == ("warn", True)


def test_drivers_that_hang_are_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkup, "TRIAL_SECONDS", 0.001)
    assert only(list(checkup.trial(settings(tmp_path)))).level == "fail"


@pytest.mark.parametrize(("level", "code"), [("ok", 0), ("warn", 0), ("fail", 1)])
def test_the_command_prints_findings_and_fails_for_those_that_matter(
    monkeypatch: pytest.MonkeyPatch, level: checkup.Level, code: int
) -> None:
    found = Finding("disk", level, "[bold]full", "make space")
    monkeypatch.setattr(checkup, "checkup", lambda _: iter([found]))
    plain, as_json = (CliRunner().invoke(app, ["doctor", *options]) for options in ([], ["--json"]))
    assert (plain.exit_code, as_json.exit_code) == (code, code)
    assert "disk: [bold]full" in plain.output
    assert "→ make space" in plain.output
    assert json.loads(as_json.stdout) == [
        {"subject": "disk", "level": level, "text": "[bold]full", "remedy": "make space"}
    ]
