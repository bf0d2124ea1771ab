"""Metrics for Prometheus: of the requests to this process, and of the whole service from its record and queue."""

import time
from collections.abc import Callable, Iterator

from prometheus_client import CollectorRegistry, Counter, Histogram, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector
from redis.exceptions import RedisError
from sqlalchemy.exc import SQLAlchemyError
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from services.jobs.queue import Queue
from services.jobs.statistics import Figures, ServiceFigures
from services.logs import logger

METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS")
BOUNDS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0)
"""Upper bounds of the histogram of answers' times, in seconds."""
log = logger(__name__)


class RequestMetrics:
    """The metrics of requests, and the registry that `/metrics` reports."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        ProcessCollector(registry=self.registry)
        self.requests = Counter(
            "scene_attack_http_requests",
            "Requests that this process of the API answered",
            ["method", "route", "status"],
            registry=self.registry,
        )
        self.seconds = Histogram(
            "scene_attack_http_request_seconds",
            "Time from a request to the beginning of its answer",
            ["method", "route"],
            buckets=BOUNDS,
            registry=self.registry,
        )


class Measured:
    """Counts requests by the template of their route, and measures the time to the beginning of the answer."""

    def __init__(self, app: ASGIApp, metrics: RequestMetrics) -> None:
        self.app = app
        self.metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        began, answered = time.perf_counter(), False

        def count(status: int) -> None:
            nonlocal answered
            answered = True
            method = scope["method"] if scope["method"] in METHODS else "other"
            route = _template(scope)
            self.metrics.requests.labels(method, route, str(status)).inc()
            self.metrics.seconds.labels(method, route).observe(time.perf_counter() - began)

        async def counted(message: Message) -> None:
            if message["type"] == "http.response.start":
                count(message["status"])
            await send(message)

        try:
            return await self.app(scope, receive, counted)
        except BaseException:
            if not answered:  # the framework answers outside of this
                count(500)
            raise


def _template(scope: Scope) -> str:
    """The path of the request's route, e.g. "/v1/jobs/{job_id}"; "none" for a path without one."""
    return getattr(scope.get("route"), "path_format", None) or "none"


class ServiceMetrics(Collector):
    """Reads the metrics of the whole service whenever they are asked for."""

    def __init__(self, figures: Figures, queue: Queue, streams: Callable[[], int]) -> None:
        self._figures = figures
        self._queue = queue
        self._streams = streams

    def collect(self) -> Iterator[Metric]:
        """The metrics; without those of the database or Redis where these do not answer."""
        up = GaugeMetricFamily("scene_attack_up", "Whether database and Redis answer", labels=["part"])
        try:
            yield from _of_record(self._figures.read())
            up.add_metric(["database"], 1)
        except SQLAlchemyError as error:
            log.warning("metrics without the database", error=str(error))
            up.add_metric(["database"], 0)
        try:
            workers = self._queue.live_workers()
            yield GaugeMetricFamily("scene_attack_workers", "Workers with a heartbeat in the last 15 seconds", workers)
            up.add_metric(["redis"], 1)
        except RedisError as error:
            log.warning("metrics without Redis", error=str(error))
            up.add_metric(["redis"], 0)
        yield up
        yield GaugeMetricFamily("scene_attack_event_streams", "Event streams of this process", self._streams())


def _of_record(figures: ServiceFigures) -> Iterator[Metric]:
    jobs = GaugeMetricFamily("scene_attack_jobs", "Jobs in the record", labels=["kind", "state"])
    for (kind, state), number in sorted(figures.jobs.items()):
        jobs.add_metric([kind, state], number)
    yield jobs
    campaigns = GaugeMetricFamily("scene_attack_campaigns", "Campaigns in the record", labels=["state"])
    for state, number in sorted(figures.campaigns.items()):
        campaigns.add_metric([state], number)
    yield campaigns
    yield GaugeMetricFamily("scene_attack_queue_jobs", "Queued jobs that may run", figures.queued)
    yield GaugeMetricFamily(
        "scene_attack_queue_oldest_seconds", "Time since the oldest of them was queued", figures.oldest_seconds
    )
    for name, of, help_ in (
        ("submitted", ["kind"], "Jobs that were queued, since the service was set up"),
        ("ended", ["kind", "state"], "Jobs that have ended"),
        ("failures", ["kind"], "Jobs that have failed, by the kind of failure"),
    ):
        counter = CounterMetricFamily(f"scene_attack_jobs_{name}", help_, labels=of)
        for label, value in figures.totals.get(name, {}).items():
            counter.add_metric(label.split(" "), value)
        yield counter
    for name, help_ in (("steps", "Steps of attacks"), ("queries", "Images that targets classified for attacks")):
        yield CounterMetricFamily(f"scene_attack_{name}", help_, figures.totals[name].get("", 0))
    stages = HistogramMetricFamily(
        "scene_attack_stage_seconds", "Time of a job in a stage: waiting in the queue, or a phase", labels=["stage"]
    )
    for stage, times in sorted(figures.stages.items()):
        stages.add_metric([stage], times.up_to, times.seconds)
    yield stages
