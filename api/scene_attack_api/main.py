"""The HTTP API: its application, and the function that serves it."""

import asyncio
import gc
import socket
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from functools import partial
from importlib.metadata import version

import uvicorn
from fastapi import FastAPI
from sqlalchemy import Engine
from sqlalchemy.exc import OperationalError, SQLAlchemyError
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware

from scene_attack.errors import InvalidRequest
from scene_attack.logs import configure, logger
from scene_attack.process import check_device
from scene_attack.runs.set_up import log_plugins, set_up
from scene_attack.runs.spec import names_in
from scene_attack.scenes.library import Library
from scene_attack.strict import Names
from scene_attack_api import dashboard
from scene_attack_api.authentication import Authentication
from scene_attack_api.dashboard.assets import ASSETS_PATH
from scene_attack_api.dashboard.pages import html
from scene_attack_api.description import TAGS, describe
from scene_attack_api.middleware import (
    Answers,
    Audit,
    BodyLimit,
    Conditional,
    Measured,
    Refuse,
    RequestId,
    RequestMetrics,
    known_hosts,
    no_nul,
    same_site,
    utf8_form,
)
from scene_attack_api.problems import install
from scene_attack_api.requests import Services
from scene_attack_api.routes import artifacts, assets, campaigns, job_exports, jobs, rerenderings, service
from scene_attack_api.routes.service import ServiceMetrics
from scene_attack_api.submissions import Checks, Submissions
from scene_attack_api.uploads import MeshUploads
from scene_attack_api.warm_pool import Exporter, WarmPool, WarmProcess
from scene_attack_api.watchers import Watcher
from scene_attack_service.access.caller import Caller, OwnedAssets, Quotas
from scene_attack_service.access.keys import AccessKeys, Sessions, check_listening, listen
from scene_attack_service.jobs import processes
from scene_attack_service.jobs.database import check_database, migrate
from scene_attack_service.jobs.database import connect as connect_database
from scene_attack_service.jobs.files import ArtifactStore, Storage
from scene_attack_service.jobs.processes import WARM_PROCESSES
from scene_attack_service.jobs.queue import Queue
from scene_attack_service.jobs.queue import connect as connect_redis
from scene_attack_service.jobs.record import Record
from scene_attack_service.jobs.uploads import DeletedAssets
from scene_attack_service.settings import Settings

MIGRATION_SECONDS = 10.0
"""Longest wait for the database at the start, after which requests are answered, if only by 503."""
RETRY_SECONDS = 1.0
"""Time between two tries to open a database that is away."""

HEAD_BYTES = 2**16
"""Largest head of a request."""
MOST_CONNECTIONS = 500
"""Open connections, and requests being answered, from which on the server answers 503. Fewer than the 1,024 files that
a process may usually have open."""

_UPLOADS = (assets.PATH, ASSETS_PATH)
"""The paths that take files."""
_PACKED = ("application/octet-stream", "model/gltf-binary")
"""Types of files that are not compressed again."""
log = logger(__name__)


def create_app(values: Settings) -> FastAPI:
    """Creates the app.

    The app opens the database, Redis and its warm processes when it starts, and closes them when it ends.
    """
    metrics = RequestMetrics()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        engine = connect_database(values)
        migration = asyncio.create_task(_migrate(engine, values))
        tasks = [asyncio.create_task(_show_life()), migration]
        await asyncio.wait([migration], timeout=MIGRATION_SECONDS)
        record, owned, keys = Record(engine), OwnedAssets(engine), AccessKeys(engine)
        redis = connect_redis(values.redis_url)
        queue = Queue(redis)
        pool = WarmPool([WarmProcess(values) for _ in range(WARM_PROCESSES)])
        pool.start()
        library = Library(values.cache_dir, values.files)
        uploads = MeshUploads(library, values)
        uploads.start()
        watcher = Watcher(record, keys)
        store = ArtifactStore(values.files)
        quotas = Quotas(owned, values.owner_queued, values.owner_campaigns, values.owner_upload_bytes)

        def names(caller: Caller) -> Names:
            return names_in(library, owned.visible(caller))

        app.state.services = Services(
            keys=keys,
            sessions=Sessions(engine),
            assets=owned,
            quotas=quotas,
            record=record,
            queue=queue,
            submissions=Submissions(record, queue, quotas, names, values.max_queued),
            store=store,
            library=library,
            uploads=uploads,
            pool=pool,
            checks=Checks(pool, names, values),
            exporter=Exporter(pool),
            watcher=watcher,
            storage=Storage(values.data_dir, store),
            deleted_assets=DeletedAssets(record.database, library),
        )
        service_metrics = ServiceMetrics(record.figures, queue, watcher.streams)
        metrics.registry.register(service_metrics)
        try:
            yield
        finally:
            metrics.registry.unregister(service_metrics)
            for task in tasks:
                task.cancel()
            watcher.close()
            pool.close()
            uploads.close()
            redis.close()
            engine.dispose()

    app = FastAPI(
        title="scene-attack",
        version=version("scene-attack"),
        lifespan=lifespan,
        separate_input_output_schemas=False,
        # A route's function is named as the operation, as in `scene_attack.client.operations` and generated clients.
        generate_unique_id_function=lambda route: route.name,
        openapi_tags=TAGS,
        openapi_url=None,  # scene_attack_api.description serves the document, written once: writing takes 30 ms
        docs_url=None,  # scene_attack_api.dashboard.reference is the page
        redoc_url=None,
        middleware=[
            Middleware(RequestId),
            Middleware(Measured, metrics=metrics),
            Middleware(
                GZipMiddleware,
                minimum_size=1024,
                compresslevel=4,  # shrinks a list of 50 jobs to a tenth; 9 takes twice as long for 1 % less
                exclude_content_types=(*DEFAULT_EXCLUDED_CONTENT_TYPES, *_PACKED),
            ),
            Middleware(Conditional),
            Middleware(Answers),
            Middleware(Audit),
            Middleware(Refuse, checks=(known_hosts(values.own_hosts), same_site)),
            Middleware(Authentication),
            Middleware(Refuse, checks=(no_nul, utf8_form)),
            Middleware(BodyLimit, uploads=dict.fromkeys(_UPLOADS, values.max_upload_bytes)),
        ],
    )
    for part in (job_exports, jobs, campaigns, artifacts, rerenderings, assets, service, dashboard):
        app.include_router(part.router)
    app.state.metrics = metrics
    install(app, partial(html, "error.html"))
    describe(app)
    return app


async def _show_life() -> None:
    processes.say_started()
    while True:
        processes.say_alive()
        await asyncio.sleep(processes.LIFE_SECONDS)


async def _migrate(engine: Engine, values: Settings) -> None:
    while True:
        try:
            return await run_in_threadpool(migrate, engine, values)
        except (SQLAlchemyError, OSError, InvalidRequest) as error:
            log.warning("database not opened yet", error=str(error))
            await asyncio.sleep(RETRY_SECONDS)


def _check_database(values: Settings) -> None:
    """Raises InvalidRequest for a database that cannot be used. One that does not answer may come back."""
    engine = connect_database(values)
    try:
        with suppress(OperationalError):
            check_database(engine, values)
    finally:
        engine.dispose()


def run(values: Settings, listener: socket.socket | None = None) -> int:
    """Serves until SIGTERM or SIGINT, on a socket already listening or else on the settings' address.

    Raises InvalidRequest if the device of the settings is not there, there is no URL of a Redis, the address is taken,
    or other machines reach it and there is no key.
    """
    configure("api")
    set_up(values)
    check_device()
    check_listening(values)
    # What cannot be is refused here: the server would show a traceback.
    connect_redis(values.redis_url).close()
    _check_database(values)
    app = create_app(values)
    # What has been imported by now stays for ever: the garbage collector need not look at it again and again.
    gc.collect()
    gc.freeze()
    listener = listener or listen(values.host, values.port)
    log.info("listening", address=listener.getsockname())
    log_plugins()
    server(app).run(sockets=[listener])
    return 0


def server(app: FastAPI) -> uvicorn.Server:
    """The HTTP server of an app, with limits of heads and connections. It has none of a request's time."""
    config = uvicorn.Config(
        app,
        log_config=None,
        access_log=False,
        server_header=False,
        http="h11",  # of uvicorn's parsers the one that limits heads
        h11_max_incomplete_event_size=HEAD_BYTES,
        limit_concurrency=MOST_CONNECTIONS,
        timeout_graceful_shutdown=2,  # event streams of running jobs would not end
    )
    return uvicorn.Server(config)


if __name__ == "__main__":
    sys.exit(run(Settings(), socket.socket(fileno=int(sys.argv[1])) if len(sys.argv) > 1 else None))
