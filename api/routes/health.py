"""Whether the service is well."""

from fastapi import APIRouter, Response
from redis.exceptions import RedisError
from sqlalchemy.exc import SQLAlchemyError

from api.schemas import ExtensionView, Health, Readiness
from api.state import ServicesDependency
from services.pipeline.extensions import EXTENSIONS

router = APIRouter(tags=["health"])


@router.get("/healthz")
async def healthz() -> Health:
    """Whether this process answers; nothing else is asked."""
    return Health(status="ok")


@router.get("/readyz", responses={503: {"model": Readiness, "description": "something is missing"}})
def readyz(services: ServicesDependency, response: Response) -> Readiness:
    """Whether database and Redis answer and a worker lives; 503 if not, saying what is missing."""
    database = redis = True
    workers = 0
    try:
        services.repository.ping()
    except SQLAlchemyError:
        database = False
    try:
        workers = services.queue.live_workers()
    except RedisError:
        redis = False
    ready = database and redis and workers > 0
    response.status_code = 200 if ready else 503
    extensions = [ExtensionView.of(extension) for extension in EXTENSIONS]
    return Readiness(ready=ready, database=database, redis=redis, workers=workers, extensions=extensions)
