"""The process that checks requests before they are accepted, and one that previews them. Its
network and OpenGL context stay loaded.

The API starts it with `python -m services.jobs.preflight_process FD`.
"""

import base64
from typing import Any

from services.analysis.images import png
from services.errors import InvalidRequest, JobFailure, out_of_memory
from services.jobs.child import OUT_OF_MEMORY, connect, reply, requests
from services.jobs.cpu_share import CHECKING, give_way
from services.jobs.outages import outage_of
from services.jobs.warm_up import warm_up
from services.logs import configure, logger
from services.pipeline.prepare import preflight
from services.pipeline.preview import planned_cost, preview
from services.pipeline.spec import JobSpec
from services.scenes.library import Library
from services.settings import Settings

log = logger(__name__)


def answer(message: dict[str, Any], library: Library) -> dict[str, Any]:
    """Answers one request: {"check": spec} by {"spec", "warnings"}, {"preview": spec} by {"preview", "png"},
    and {"plan": spec} by {"plan", "cost"}.

    A request with bad fields is answered by {"errors": [[field, detail], …]}, one that needs too much memory by
    OUT_OF_MEMORY, and a check that failed by {"trouble"}.
    """
    try:
        if "check" in message:
            found = preflight(JobSpec.model_validate(message["check"]), library)
            said = [one.model_dump(mode="json") for one in found.warnings]
            return {"spec": found.spec.model_dump(mode="json"), "warnings": said}
        if "preview" in message:
            shown, image = preview(JobSpec.model_validate(message["preview"]), library)
            return {"preview": shown.model_dump(mode="json"), "png": base64.b64encode(png(image)).decode()}
        return planned_cost(JobSpec.model_validate(message["plan"]), library).model_dump(mode="json")
    except InvalidRequest as error:
        return {"errors": [(one.field, one.detail) for one in error.every]}
    except JobFailure as error:
        log.warning("preflight failed", kind=error.kind, exc_info=error)
        return OUT_OF_MEMORY if out_of_memory(error) else {"trouble": f"{error.kind}: {error.detail}"}
    except (Exception, SystemExit) as error:  # an extension's code may end the process it is run in
        outage = outage_of(error)
        if outage is not None:
            log.warning("request met an outage", resource=outage.resource, error=str(error))
            return {"trouble": outage.detail}
        if out_of_memory(error):
            return OUT_OF_MEMORY
        log.error("preflight failed", exc_info=error)
        return {"trouble": "internal: the service's log says why"}


def main() -> None:
    """Loads network and OpenGL once, reports that it is ready, then answers requests until its parent ends."""
    configure("preflight")
    give_way(CHECKING)
    values = Settings()
    connection = connect()
    inbox = requests(connection)
    warm_up(values)
    library = Library(values.cache_dir, values.files)
    reply(connection, {"ready": True})
    for message, _ in inbox:
        reply(connection, answer(message, library))


if __name__ == "__main__":
    main()
