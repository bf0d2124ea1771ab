"""Routes for the health and the metrics of the service."""

from collections.abc import Callable, Iterator

from fastapi import APIRouter, Request, Response
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily
from prometheus_client.exposition import choose_encoder
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector
from redis.exceptions import RedisError
from sqlalchemy.exc import SQLAlchemyError

from scene_attack.client.schemas import Health, PluginView, Readiness, TargetFolderView
from scene_attack.logs import logger
from scene_attack.plugins import loaded_plugins
from scene_attack.runs.set_up import target_folders
from scene_attack_api.requests import KnownCaller, ServicesDependency
from scene_attack_service.jobs.queue import Queue
from scene_attack_service.jobs.statistics import Figures, ServiceFigures

router = APIRouter(tags=["service"])
log = logger(__name__)


@router.get("/healthz")
async def get_health() -> Health:
    """Answers 200 if this process is alive; checks nothing else."""
    return Health(status="ok")


@router.get(
    "/readyz",
    responses={
        503: {"model": Readiness, "description": "the database, Redis, the data directory or a worker is missing"}
    },
)
def get_readiness(services: ServicesDependency, response: Response, caller: KnownCaller) -> Readiness:
    """Answers 200 if database and Redis answer, the data directory can be written and a worker is alive, otherwise 503,
    and says which are missing.
    """
    database = redis = True
    workers = 0
    try:
        services.record.database.ping()
    except SQLAlchemyError:
        database = False
    try:
        workers = services.queue.live_workers()
    except RedisError:
        redis = False
    storage = services.storage.usable()
    ready = database and redis and storage and workers > 0
    response.status_code = 200 if ready else 503
    plugins = None if caller is None else [PluginView.of(plugin) for plugin in loaded_plugins()]
    targets = None if caller is None else [TargetFolderView.of(folder) for folder in target_folders()]
    return Readiness(
        ready=ready,
        database=database,
        redis=redis,
        storage=storage,
        worker=workers > 0,
        workers=workers,
        plugins=plugins,
        targets=targets,
    )


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
def get_metrics(request: Request) -> Response:
    """Reports metrics for Prometheus: the requests of this process, and the queue, jobs and workers of the service.

    Counters of jobs, steps, queries and stages are kept in the database: they are the same from every process, and
    never fall.
    """
    try:
        encode, media_type = choose_encoder(request.headers.get("accept", ""))
    except (TypeError, ValueError):  # a version that is none
        encode, media_type = choose_encoder("")
    return Response(encode(request.app.state.metrics.registry), media_type=media_type)


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
