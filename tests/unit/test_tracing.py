"""Spans as a real receiver of OpenTelemetry's protocol gets them."""

import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

import pytest

from services import tracing
from tests import otlp_receiver
from tests.otlp_receiver import Receiver

TRACE, PARENT = "0af7651916cd43dd8448eb211c80319c", "b7ad6b7169203331"
CONTEXT = f"00-{TRACE}-{PARENT}-01"
CONSUMER = 5


@pytest.fixture
def receiver(monkeypatch: pytest.MonkeyPatch) -> Iterator[Receiver]:
    with otlp_receiver.running() as server:
        monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", server.url)
        tracing.configure("test")
        yield server
        tracing.close()


def test_spans_form_the_tree_of_their_blocks_below_the_given_context(receiver: Receiver) -> None:
    with tracing.span("job", CONTEXT, "consumer", {"n": 1}):
        stages = tracing.Stages()
        for name in ("loading", "loading", "attacking"):
            stages.enter(name)
        stages.enter(None)
        with tracing.span("inner"):
            carried = tracing.context()
        tracing.describe({"error.type": "internal"}, name="renamed", error="because")
    tracing.close()
    assert [span.name for span in receiver.spans] == ["loading", "attacking", "inner", "renamed"]
    [outer] = receiver.named("renamed")
    assert (outer.trace, outer.parent, outer.kind, outer.failed) == (TRACE, PARENT, CONSUMER, True)
    assert outer.attributes == {"n": 1, "error.type": "internal"}
    assert outer.resource["service.name"] == "scene-attack"
    for name in ("loading", "attacking", "inner"):
        [span] = receiver.named(name)
        assert (span.trace, span.parent, span.failed) == (TRACE, outer.id, False)
    assert carried == f"00-{TRACE}-{receiver.named('inner')[0].id}-01"


def test_a_span_may_be_told_of_afterwards(receiver: Receiver) -> None:
    began = datetime(2030, 1, 1, 0, 0, 0, 123456, tzinfo=UTC)
    tracing.record("queued", began, began + timedelta(seconds=2), CONTEXT, tracing.job("ab", 3))
    tracing.record("of no trace", began, began, None)
    tracing.close()
    [span] = receiver.spans
    assert (span.name, span.trace, span.parent) == ("queued", TRACE, PARENT)
    assert span.began == int(began.timestamp()) * 10**9 + 123_456_000
    assert span.ended - span.began == 2 * 10**9
    assert span.attributes == {"scene_attack.job.id": "ab", "scene_attack.job.attempt": 3}


def test_a_context_that_is_none_begins_a_trace(receiver: Receiver) -> None:
    with tracing.span("root", "nonsense"):
        pass
    tracing.close()
    [span] = receiver.spans
    assert span.parent == ""


def test_an_error_passes_and_its_words_stay_here(receiver: Receiver) -> None:
    with pytest.raises(ValueError, match="what a client sent"), tracing.span("validate"):
        raise ValueError("what a client sent")
    tracing.close()
    [span] = receiver.spans
    assert not span.failed


@pytest.mark.usefixtures("receiver")
def test_a_client_may_decide_that_its_trace_is_not_sampled(receiver: Receiver) -> None:
    with tracing.span("job", f"00-{TRACE}-{PARENT}-00"):
        assert tracing.context() is not None
    tracing.close()
    assert receiver.spans == []


@pytest.mark.parametrize(
    "environ",
    [
        {},
        {"OTEL_EXPORTER_OTLP_ENDPOINT": "http://127.0.0.1:9", "OTEL_SDK_DISABLED": "true"},
        {"OTEL_EXPORTER_OTLP_TRACES_ENDPOINT": "http://127.0.0.1:9", "OTEL_TRACES_EXPORTER": "none"},
    ],
)
def test_what_is_not_asked_for_does_nothing(environ: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in environ.items():
        monkeypatch.setenv(name, value)
    tracing.configure("test")
    assert not tracing.on()
    with tracing.span("a", CONTEXT):
        assert tracing.context() is None
    tracing.record("b", datetime.now(UTC), datetime.now(UTC), CONTEXT)
    tracing.describe({"a": 1}, error="b")
    tracing.Stages().enter("c")
    tracing.close()


SCRIPT = """
import sys
{before}
from services import tracing
tracing.configure("test")
with tracing.span("a"):
    tracing.Stages().enter("b")
assert not tracing.on()
assert not [name for name in sys.modules if name.startswith("opentelemetry.sdk") and sys.modules[name]]
"""


@pytest.mark.parametrize("extra", ["not asked for", "missing"])
def test_nothing_is_imported_and_a_missing_extra_is_said(extra: str) -> None:
    missing = extra == "missing"
    before = 'sys.modules["opentelemetry.exporter"] = None' if missing else ""
    environ = {"OTEL_EXPORTER_OTLP_ENDPOINT": "http://127.0.0.1:9"} if missing else {}
    command = [sys.executable, "-c", SCRIPT.format(before=before)]
    ended = subprocess.run(command, env=environ, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert ("scene-attack[tracing]" in ended.stdout + ended.stderr) == missing
