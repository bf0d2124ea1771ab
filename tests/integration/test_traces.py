"""A job's trace, from the client that posts it to its artifacts, as a receiver of OpenTelemetry's protocol gets it."""

from itertools import pairwise
from pathlib import Path

import pytest

from tests import otlp_receiver
from tests.integration.conftest import serving, until
from tests.integration.specs import QUICK

pytestmark = pytest.mark.integration

TRACE, PARENT = "0af7651916cd43dd8448eb211c80319c", "b7ad6b7169203331"
OF_THE_REQUEST = {"validate", "names", "check", "record", "send", "lease", "queued", "job"}
OF_THE_JOB = ["loading", "attacking", "analysing", "keeping"]


def test_a_job_is_in_the_trace_of_its_request(tmp_path: Path) -> None:
    with otlp_receiver.running() as receiver:
        traced = {"OTEL_EXPORTER_OTLP_ENDPOINT": receiver.url, "OTEL_BSP_SCHEDULE_DELAY": "100"}
        with serving(tmp_path / "data", **traced) as stack:
            headers = {"traceparent": f"00-{TRACE}-{PARENT}-01", "X-Request-ID": "r1"}
            job_id = stack.client.post("/v1/jobs", json=QUICK, headers=headers).raise_for_status().json()["id"]
            stack.ended(job_id)
            until(lambda: receiver.named("job"), "the job's span")
            until(lambda: receiver.named("POST /v1/jobs"), "the request's span")
            until(lambda: receiver.named("lease"), "the worker's span")
        mine = [span for span in receiver.spans if span.trace == TRACE]
        [post] = [span for span in mine if span.name == "POST /v1/jobs"]
        assert post.parent == PARENT
        assert post.attributes["http.response.status_code"] == 202
        assert post.attributes["scene_attack.request.id"] == "r1"
        assert {span.name for span in mine if span.parent == post.id} == OF_THE_REQUEST
        [job] = [span for span in mine if span.name == "job"]
        assert job.attributes == {"scene_attack.job.id": job_id, "scene_attack.job.attempt": 1}
        stages = sorted((span for span in mine if span.parent == job.id), key=lambda span: span.began)
        assert [span.name for span in stages] == OF_THE_JOB
        assert all(before.ended <= after.began for before, after in pairwise(stages))
        assert job.began <= stages[0].began
        assert stages[-1].ended <= job.ended
        assert len(mine) == 1 + len(OF_THE_REQUEST) + len(OF_THE_JOB)
        processes = {span.resource["process.executable.name"] for span in mine}
        assert processes == {f"scene-attack {name}" for name in ("api", "worker", "job")}
