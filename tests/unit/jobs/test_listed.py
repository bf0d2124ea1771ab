import json
from pathlib import Path
from typing import Any

import pytest
from alembic import command
from alembic.config import Config
from sqlalchemy import Engine, text

from services.jobs.database import MIGRATIONS, connect, migrate
from services.jobs.listed import LONGEST, listed
from services.jobs.repository import Repository
from services.settings import Settings
from tests.unit.jobs.records import SPEC, add, attacks

ASKED: dict[str, Any] = SPEC.model_dump(mode="json") | {
    "target": {"name": "iep", "question": "How many cubes are there?", "questions": []}
}


def test_what_a_list_shows_of_a_request() -> None:
    columns = listed(ASKED)
    assert columns["name"] == columns["question"] == "How many cubes are there?"
    assert (columns["scene"], columns["target"]) == ("sphere", "iep")
    attack = ASKED["attack"]
    assert columns["attack"] == f"{columns['renderer']} combined {columns['method']}"
    assert (columns["renderer"], columns["method"]) == (attack["renderer"], attack["method"])
    assert listed(SPEC.model_dump(mode="json"))["question"] is None


def test_a_scene_of_many_meshes_is_cut() -> None:
    spec = ASKED | {"scene": {"objects": [{"mesh": "primitive/sphere"}] * 100}}
    scene = listed(spec)["scene"]
    assert scene is not None
    assert len(scene) == LONGEST
    assert scene.startswith("sphere, sphere")
    assert scene.endswith("…")


def test_lists_read_neither_request_nor_result(repository: Repository) -> None:
    add(repository)
    [job] = attacks(repository)
    assert (job.name, job.seed) == ("sphere", 7)
    for column in ("spec", "result"):
        with pytest.raises(AttributeError):
            getattr(job, column)


def test_the_migration_fills_the_columns_of_jobs_that_are_there(tmp_path: Path) -> None:
    settings = Settings(data=tmp_path)
    (tmp_path / "jobs.sqlite").touch()
    engine = connect(settings)
    before(engine, "0004")
    with engine.begin() as connection:
        for kind, spec in (("attack", ASKED), ("selection", {"views": []})):
            connection.execute(
                text(
                    "INSERT INTO jobs (id, state, spec, seed, created_at, attempt, lost, events, kind) VALUES"
                    " (:kind, 'queued', :spec, 1, '2030-01-01 00:00:00', 0, 0, 0, :kind)"
                ),
                {"kind": kind, "spec": json.dumps(spec)},
            )
    migrate(engine, settings)
    repository = Repository(engine)
    job, selection = repository.line("attack"), repository.work("selection")
    assert job is not None
    assert selection is not None
    assert {column: getattr(job, column) for column in listed(ASKED)} == listed(ASKED)
    assert selection.name is None
    engine.dispose()


def before(engine: Engine, revision: str) -> None:
    """Makes the tables as they were at a revision."""
    with engine.execution_options(writes=True).begin() as connection:
        config = Config()
        config.set_main_option("script_location", str(MIGRATIONS))
        config.attributes["connection"] = connection
        command.upgrade(config, revision)
