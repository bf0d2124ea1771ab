"""Routes for the health and the metrics of the service."""

from fastapi import APIRouter, Request, Response
from prometheus_client.exposition import choose_encoder
from redis.exceptions import RedisError
from sqlalchemy.exc import SQLAlchemyError

from api.access.authentication import KnownCaller
from api.schemas import ExtensionView, Health, Readiness, TargetFolderView
from api.state import ServicesDependency
from services.pipeline.extensions import loaded_extensions, target_folders

router = APIRouter(tags=["service"])


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
    extensions = None if caller is None else [ExtensionView.of(extension) for extension in loaded_extensions()]
    targets = None if caller is None else [TargetFolderView.of(folder) for folder in target_folders()]
    return Readiness(
        ready=ready,
        database=database,
        redis=redis,
        storage=storage,
        worker=workers > 0,
        workers=workers,
        extensions=extensions,
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
