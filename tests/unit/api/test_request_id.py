import json
import logging

import pytest
from httpx import Client

from api.problems import REQUEST_ID
from services import logs
from tests.unit.api.conftest import SPHERE


@pytest.mark.parametrize("given", ["a", "0af7651916cd43dd8448eb211c80319c", "proxy-1:2_3.4", "x" * 128])
def test_the_id_of_a_client_or_proxy_is_returned(client: Client, given: str) -> None:
    assert client.get("/healthz", headers={REQUEST_ID: given}).headers[REQUEST_ID] == given


@pytest.mark.parametrize("given", ["", "x" * 129, "a b", "ä", "a\tb", '{"a": 1}', "<script>"])
def test_another_one_is_replaced(client: Client, given: str) -> None:
    answers = [client.get("/v1/jobs/none", headers=[(REQUEST_ID.encode(), given.encode("latin-1"))]) for _ in range(2)]
    made = {answer.headers[REQUEST_ID] for answer in answers}
    assert len(made) == 2
    assert all(len(one) == 32 for one in made)


def test_lines_carry_the_ids_of_request_job_and_attempt(
    client: Client, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    root = logging.getLogger()
    monkeypatch.setattr(root, "handlers", [])
    monkeypatch.setattr(root, "level", root.level)
    logs.configure("test")
    client.post("/v1/jobs", json=SPHERE, headers={REQUEST_ID: "mine"})
    with logs.bound(job="ab", attempt=2):
        logging.getLogger("a.library").warning("careful")
    logging.getLogger("a.library").warning("without")
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines() if line.startswith("{")]
    [queued] = [line for line in lines if line["event"] == "job queued"]
    assert (queued["request"], queued["process"]) == ("mine", "test")
    [careful] = [line for line in lines if line["event"] == "careful"]
    assert (careful["job"], careful["attempt"]) == ("ab", 2)
    [without] = [line for line in lines if line["event"] == "without"]
    assert "job" not in without
