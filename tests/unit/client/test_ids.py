"""The beginning of an id stands for the whole one, if there is no other."""

import json

import pytest
from typer.testing import CliRunner

from scene_attack import Client
from scene_attack.cli.app import app
from scene_attack.cli.commands.options import whole_campaign_id, whole_job_id
from scene_attack.errors import InvalidRequest
from tests.unit.client.scripted_service import Script, client, job, says, script

pytestmark = pytest.mark.slow

__all__ = ["client", "script"]  # fixtures

ONE, TWO, THREE = "0f3c" + "0" * 28, "0f3d" + "0" * 28, "a" * 32
PAGES = [
    {"items": [job(id=ONE, name="piano"), job(id=THREE, name="lamp")], "next": "c"},
    {"items": [job(id=TWO, name="chair")], "next": None},
]


@pytest.mark.parametrize(("text", "found"), [("0f3c", ONE), ("0F3D", TWO), ("a", THREE), ("0f3c…", ONE)])
def test_a_beginning_is_completed(client: Client, script: Script, text: str, found: str) -> None:
    script.answers = [says(200, page) for page in PAGES]
    assert whole_job_id(client, text) == found
    asked = f"GET /v1/jobs?q=id%3A{text.strip('…').lower()}&limit=200"  # the service looks for it
    assert script.paths == [asked, f"{asked}&cursor=c"]


def test_a_whole_id_is_not_looked_up(client: Client, script: Script) -> None:
    assert whole_job_id(client, ONE) == ONE
    assert script.seen == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0f3", "'0f3' is the beginning of 2 ids: 0f3c0000 (piano), 0f3d0000 (chair); give more digits"),
        ("bc", "there is no job whose id begins with 'bc'"),
    ],
)
def test_one_that_is_not_one_job_says_so(client: Client, script: Script, text: str, said: str) -> None:
    script.answers = [says(200, page) for page in PAGES]
    with pytest.raises(InvalidRequest) as error:
        whole_job_id(client, text)
    assert (error.value.field, error.value.detail) == ("ID", said)


@pytest.mark.parametrize("text", ["piano", "", "../jobs", "0" * 33])
def test_what_is_no_id_is_refused_before_anybody_is_asked(client: Client, script: Script, text: str) -> None:
    with pytest.raises(InvalidRequest, match="is no id of a campaign"):
        whole_campaign_id(client, text)
    assert script.seen == []


def listed(client: Client, script: Script, *arguments: str) -> tuple[list[str], bool]:
    """The names of the jobs that `jobs list --json` prints, and whether there are more."""
    script.answers = [says(200, page) for page in PAGES]
    done = CliRunner().invoke(app, ["jobs", "list", "--json", "--url", client.url, *arguments])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    return [job["name"] for job in found["items"]], found["more"]


@pytest.mark.parametrize(
    ("arguments", "names", "more"),
    [
        ([], ["piano", "lamp", "chair"], False),
        (["--limit", "2"], ["piano", "lamp"], True),
        (["--limit", "1", "--all"], ["piano", "lamp", "chair"], False),
        (["-n", "3"], ["piano", "lamp", "chair"], False),
    ],
)
def test_a_list_has_as_many_pages_as_are_wanted(
    client: Client, script: Script, arguments: list[str], names: list[str], more: bool
) -> None:
    assert listed(client, script, *arguments) == (names, more)


def test_filters_are_sent(client: Client, script: Script) -> None:
    listed(client, script, "--state", "failed", "--campaign", ONE, "-q", "verified", "--sort", "p")
    assert script.seen[0][1] == f"/v1/jobs?q=verified&sort=p&state=failed&campaign={ONE}&limit=200"


def test_states_are_sent_one_by_one(client: Client, script: Script) -> None:
    listed(client, script, "--state", "running, queued")
    assert script.seen[0][1] == "/v1/jobs?sort=-created&state=running&state=queued&limit=200"
