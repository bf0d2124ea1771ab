"""The commands that name and repeat a job."""

import json

import pytest
from typer.testing import CliRunner

from client.api_client import ApiClient
from client.cli import app
from tests.unit.client.test_api_client import Script, client, says, script

__all__ = ["client", "script"]  # fixtures

JOB = "0f3c" + "0" * 28


def said(client: ApiClient, *arguments: str) -> str:
    done = CliRunner().invoke(app, ["jobs", *arguments, "--url", client.url])
    assert done.exit_code == 0, done.output
    return done.stdout.strip()


@pytest.mark.parametrize("command", ["retry", "continue"])
def test_a_job_that_is_queued_again_prints_its_new_id(client: ApiClient, script: Script, command: str) -> None:
    script.answers = [says(202, {"id": "a" * 32, "state": "queued"})]
    assert said(client, command, JOB) == "a" * 32
    assert [(method, path) for method, path, _ in script.seen] == [("POST", f"/v1/jobs/{JOB}/{command}")]


def test_tags_are_added_and_taken_away(client: ApiClient, script: Script) -> None:
    script.answers = [
        says(200, {"id": JOB, "tags": ["a", "old"]}),
        says(200, {"id": JOB, "name": "piano", "title": None, "tags": ["a", "paper"]}),
    ]
    assert said(client, "edit", JOB, "--tag", "paper", "--untag", "old") == f"{JOB}  piano [a] [paper]"
    assert [(method, path) for method, path, _ in script.seen] == [
        ("GET", f"/v1/jobs/{JOB}"),
        ("PATCH", f"/v1/jobs/{JOB}"),
    ]
    assert json.loads(script.bodies[-1]) == {"tags": ["a", "paper"]}


@pytest.mark.parametrize(("given", "sent"), [("Figure 3", "Figure 3"), ("", "")])
def test_a_title_alone_leaves_the_tags(client: ApiClient, script: Script, given: str, sent: str) -> None:
    script.answers = [says(200, {"id": JOB, "name": "piano", "title": sent or None, "tags": ["a"]})]
    assert said(client, "edit", JOB, "--title", given) == f"{JOB}  {sent or 'piano'} [a]"
    assert json.loads(script.bodies[-1]) == {"title": sent}
