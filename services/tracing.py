"""Traces of requests and jobs by OpenTelemetry: spans, and the context that a job carries from its request to its end.

The standard variables configure it. Without `OTEL_EXPORTER_OTLP_ENDPOINT` (or `OTEL_EXPORTER_OTLP_TRACES_ENDPOINT`)
nothing of OpenTelemetry is imported, and every function here returns at once. A context is the text of W3C's header
`traceparent`.
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from typing import Any, Literal

from services.logs import logger

HEADER = "traceparent"
_ENDPOINTS = ("OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT")

log = logger(__name__)

Kind = Literal["internal", "server", "producer", "consumer"]

_provider: Any = None
_tracer: Any = None


def wanted() -> bool:
    """Whether the environment asks for traces."""
    off = os.environ.get("OTEL_SDK_DISABLED", "").strip().lower() == "true"
    exporter = os.environ.get("OTEL_TRACES_EXPORTER", "otlp").strip().lower()
    return not off and exporter != "none" and any(os.environ.get(name, "").strip() for name in _ENDPOINTS)


def configure(process: str) -> None:
    """Begins to send the spans of this process if the environment asks for it. `process` is its name, as in the log."""
    global _provider, _tracer
    if not wanted():
        return
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
        from opentelemetry.sdk.resources import Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor
    except ImportError as error:
        log.warning("no traces: the extra is missing", missing=error.name, remedy="pip install 'scene-attack[tracing]'")
        return
    about = {"process.executable.name": f"scene-attack {process}"}
    named = os.environ.get("OTEL_SERVICE_NAME") or "service.name=" in os.environ.get("OTEL_RESOURCE_ATTRIBUTES", "")
    if not named:
        about["service.name"] = "scene-attack"
    _provider = TracerProvider(resource=Resource.create(about))
    _provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    _tracer = _provider.get_tracer("scene-attack")


def close() -> None:
    """Sends what is left, and ends."""
    global _provider, _tracer
    if _provider is not None:
        _provider.shutdown()
    _provider = _tracer = None


def on() -> bool:
    """Whether this process sends spans."""
    return _tracer is not None


@contextmanager
def span(
    name: str, parent: str | None = None, kind: Kind = "internal", attributes: Mapping[str, Any] | None = None
) -> Iterator[None]:
    """A span around a block. It is a child of the block around it, or of the context `parent` if there is none."""
    if _tracer is None:
        yield
        return
    quiet = {"record_exception": False, "set_status_on_exception": False}  # they may quote what a client sent
    with _tracer.start_as_current_span(name, _context(parent), _kind(kind), attributes, **quiet):
        yield


def record(
    name: str, began: datetime, ended: datetime, parent: str | None, attributes: Mapping[str, Any] | None = None
) -> None:
    """A span whose times are known. Nothing is recorded without a context."""
    if _tracer is not None and parent is not None:
        made = _tracer.start_span(name, _context(parent), attributes=attributes, start_time=_nanoseconds(began))
        made.end(_nanoseconds(ended))


def describe(attributes: Mapping[str, Any], *, name: str | None = None, error: str | None = None) -> None:
    """Adds to the span around the caller: attributes, another name, and that it failed."""
    if _tracer is None:
        return
    from opentelemetry.trace import Status, StatusCode, get_current_span

    here = get_current_span()
    here.set_attributes(dict(attributes))
    if name is not None:
        here.update_name(name)
    if error is not None:
        here.set_status(Status(StatusCode.ERROR, error))


def context() -> str | None:
    """The context of the span around the caller, for a job to carry; None without traces."""
    if _tracer is None:
        return None
    from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

    carrier: dict[str, str] = {}
    TraceContextTextMapPropagator().inject(carrier)
    return carrier.get(HEADER)


def job(job_id: str, attempt: int) -> dict[str, Any]:
    """The attributes of a span of a job."""
    return {"scene_attack.job.id": job_id, "scene_attack.job.attempt": attempt}


class Stages:
    """Spans that follow one another inside the span around the caller."""

    def __init__(self) -> None:
        self._open: Any = None
        self._name: str | None = None

    def enter(self, name: str | None) -> None:
        """Ends the open span and begins the next, unless it has this name; None only ends it."""
        if _tracer is None or name == self._name:
            return
        if self._open is not None:
            self._open.end()
        self._name = name
        self._open = None if name is None else _tracer.start_span(name)


def _context(parent: str | None) -> Any:
    """The context to start a span in; None is that of the caller."""
    from opentelemetry.trace import get_current_span
    from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

    if parent is None or get_current_span().get_span_context().is_valid:
        return None
    return TraceContextTextMapPropagator().extract({HEADER: parent})


def _kind(kind: Kind) -> Any:
    from opentelemetry.trace import SpanKind

    return SpanKind[kind.upper()]


def _nanoseconds(time: datetime) -> int:
    return (time - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1000
