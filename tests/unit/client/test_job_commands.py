"""The commands `submit` and `jobs` at a service."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from scene_attack import Client
from scene_attack.cli.app import app
from scene_attack.errors import InvalidRequest
from tests.unit.client.scripted_service import Script, client, job, printed, says, script

pytestmark = pytest.mark.slow

__all__ = ["client", "script"]  # fixtures

ID = "0f3c" + "0" * 28


def test_a_priority_is_sent_if_one_is_given(client: Client, script: Script) -> None:
    script.answers = [says(202, job())] * 2
    printed(client, "submit", "-", "--priority", "low", stdin='{"scene": {}}')
    printed(client, "submit", "-", stdin='{"scene": {}}')
    assert script.paths == ["POST /v1/jobs?priority=low", "POST /v1/jobs"]


def test_a_priority_of_another_name_is_refused(client: Client, script: Script) -> None:
    done = CliRunner().invoke(app, ["submit", "-", "--priority", "urgent", "--url", client.url], input="{}")
    assert done.exit_code == 2
    assert script.seen == []


def test_a_job_that_no_worker_can_run_says_why(client: Client, script: Script) -> None:
    why = "no worker that is running has the device cuda"
    waiting = job(state="queued", waiting=why)
    script.answers = [says(200, {"items": [waiting, job()], "next": None}), says(200, waiting)]
    assert printed(client, "jobs", "list").count(why) == 1
    assert f"waits: {why}" in printed(client, "jobs", "show", ID)


def test_a_job_is_shown_as_people_call_it(client: Client, script: Script) -> None:
    failed = job(state="failed", name="vase", failure={"kind": "timeout", "detail": "it took 3,600 s"})
    script.answers = [
        says(200, failed),
        says(200, failed | {"title": "Figure 3", "tags": ["paper"], "note": "Look twice."}),
    ]
    plain, named = printed(client, "jobs", "show", ID), printed(client, "jobs", "show", ID)
    assert "vase" in plain
    assert "failed (timeout): it took 3,600 s" in plain
    assert all(text in named for text in ("Figure 3", "tags: paper", "note: Look twice."))


@pytest.mark.parametrize("command", ["retry", "continue"])
def test_a_job_that_is_queued_again_prints_its_new_id(client: Client, script: Script, command: str) -> None:
    script.answers = [says(202, job(id="a" * 32))]
    assert printed(client, "jobs", command, ID).strip() == "a" * 32
    assert script.paths == [f"POST /v1/jobs/{ID}/{command}"]


def test_tags_are_added_and_taken_away(client: Client, script: Script) -> None:
    script.answers = [
        says(200, job(id=ID, tags=["a", "old"])),
        says(200, job(id=ID, name="piano", tags=["a", "paper"])),
    ]
    words = printed(client, "jobs", "edit", ID, "--tag", "paper", "--untag", "old")
    assert words.strip() == f"{ID}  piano [a] [paper]"
    assert script.paths == [f"GET /v1/jobs/{ID}", f"PATCH /v1/jobs/{ID}"]
    assert json.loads(script.bodies[-1]) == {"tags": ["a", "paper"]}


@pytest.mark.parametrize("title", ["Figure 3", ""])
def test_a_title_alone_leaves_the_tags(client: Client, script: Script, title: str) -> None:
    script.answers = [says(200, job(id=ID, name="piano", title=title or None, tags=["a"]))]
    assert printed(client, "jobs", "edit", ID, "--title", title).strip() == f"{ID}  {title or 'piano'} [a]"
    assert json.loads(script.bodies[-1]) == {"title": title}


def test_a_folder_of_another_job_is_not_written(client: Client, script: Script, tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text("{}")
    file = {"name": "result.json", "sha256": "0" * 64, "media_type": "application/json", "size": 2}
    script.answers = [says(200, {"items": [file]})]
    done = CliRunner().invoke(app, ["jobs", "download", ID, "--out", str(tmp_path), "--url", client.url])
    assert isinstance(done.exception, InvalidRequest)
    assert "holds the result of another job" in str(done.exception)
    assert (tmp_path / "result.json").read_text() == "{}"
