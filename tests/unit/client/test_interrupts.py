"""Ctrl-C says what becomes of the job."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from scene_attack.cli.commands import jobs, run
from scene_attack.client.client import Client, Event, Job
from scene_attack.client.schemas import JobView
from tests.unit.client.scripted_service import job

SPHERE = {"scene": {"objects": [{"mesh": "primitive/sphere"}]}}


class Interrupted(Client):
    """The events of a job, while which Ctrl-C is pressed."""

    def stream_job_events(self, job_id: str, after: str | None = None) -> Iterator[Event]:
        yield Event("1", "progress", {"phase": "attacking", "step": 3, "steps": 9, "rows": []})
        raise KeyboardInterrupt


def test_a_job_of_a_service_goes_on(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(KeyboardInterrupt):
        jobs.follow(Job(JobView.model_validate(job(id="0f3c")), Interrupted()))
    assert "The job goes on. `scene-attack jobs watch 0f3c` follows it" in capfd.readouterr().err


def test_a_job_of_this_process_goes_on_by_the_same_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def execute(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "_execute", execute)
    monkeypatch.setattr(run, "keep_memory", lambda: None)  # it would start this program anew
    (tmp_path / "spec.json").write_text(json.dumps(SPHERE))
    with pytest.raises(KeyboardInterrupt):
        run.run(str(tmp_path / "spec.json"), tmp_path / "out")
    assert "the same command goes on" in capfd.readouterr().err
