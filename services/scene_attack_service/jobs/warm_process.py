"""The program of the API's warm processes: it checks and previews requests, and makes exports of finished jobs and
assets. Its network and OpenGL context stay loaded.

The API starts it with `python -m scene_attack_service.jobs.warm_process FD`.
"""

import base64
from functools import partial
from pathlib import Path
from typing import Any

from scene_attack.analysis.images import png
from scene_attack.errors import InvalidRequest, JobFailure, out_of_memory
from scene_attack.export import ASSET, BUNDLE
from scene_attack.export.bundle import read_finished, write_bundle, zipped
from scene_attack.export.glb import asset_glb
from scene_attack.logs import configure, logger
from scene_attack.runs.prepare import prepare
from scene_attack.runs.preview import planned_cost, preview
from scene_attack.runs.spec import JobSpec
from scene_attack.scenes.library import Library
from scene_attack_service.jobs.database import outage_of
from scene_attack_service.jobs.files import ArtifactStore, Damaged
from scene_attack_service.jobs.processes import CHECKING, OUT_OF_MEMORY, connect, give_way, reply, requests, warm_up
from scene_attack_service.settings import Settings

log = logger(__name__)


def answer(message: dict[str, Any], library: Library, store: ArtifactStore) -> dict[str, Any]:
    """Answers one request: {"check": spec} by {"spec", "warnings"}, {"preview": spec} by {"preview", "png"},
    {"plan": spec} by {"plan", "cost"}, and {"export": …} as `export` says.

    A request with bad fields is answered by {"errors": [[field, detail], …]}, one that needs too much memory by
    OUT_OF_MEMORY, and one that failed by {"trouble"}.
    """
    try:
        if "check" in message:
            prepared = prepare(JobSpec.model_validate(message["check"]), library)
            warnings = [warning.model_dump(mode="json") for warning in prepared.settled.warnings]
            return {"spec": prepared.spec.model_dump(mode="json"), "warnings": warnings}
        if "preview" in message:
            shown, image = preview(JobSpec.model_validate(message["preview"]), library)
            return {"preview": shown.model_dump(mode="json"), "png": base64.b64encode(png(image)).decode()}
        if "plan" in message:
            return planned_cost(JobSpec.model_validate(message["plan"]), library).model_dump(mode="json")
        return export(message["export"], library, store)
    except InvalidRequest as error:
        return {"errors": [(invalid.field, invalid.detail) for invalid in error.every]}
    except JobFailure as error:
        log.warning("request failed", kind=error.kind, exc_info=error)
        return OUT_OF_MEMORY if out_of_memory(error) else {"trouble": f"{error.kind}: {error.detail}"}
    except (Exception, SystemExit) as error:  # a plug-in's code may end the process it is run in
        outage = outage_of(error)
        if outage is not None:
            log.warning("request met an outage", resource=outage.resource, error=str(error))
            return {"trouble": outage.detail}
        if out_of_memory(error):
            return OUT_OF_MEMORY
        log.error("request failed", exc_info=error)
        return {"trouble": "internal: the service's log says why"}


def export(message: dict[str, Any], library: Library, store: ArtifactStore) -> dict[str, Any]:
    """Makes what a message asks for: {"what": BUNDLE, "before" or "after", "job": id, "artifacts": {name: sha256},
    "out": path} or {"what": ASSET, "mesh": name, "out": path}. Writes the file `out` and answers {}, or
    {"refused": sentence}.
    """
    files = {name: partial(_read, store, sha256) for name, sha256 in message.get("artifacts", {}).items()}
    try:
        with Path(message["out"]).open("r+b") as out:  # it makes no file if the client has gone, and with it this one
            if message["what"] == ASSET:
                out.write(asset_glb(message["mesh"], library))
            elif message["what"] == BUNDLE:
                with zipped(out, f"scene-attack-{message['job'][:8]}") as write:
                    write_bundle(files, library, write, message["job"])
            else:
                out.write(read_finished(files, library).glb(message["what"]))
    except InvalidRequest as error:
        return {"refused": f"{error.field}: {error.detail}"}
    except JobFailure as error:
        return OUT_OF_MEMORY if out_of_memory(error) else {"refused": error.detail}
    except (FileNotFoundError, Damaged) as error:
        return {"refused": f"a file of the job is gone from the artifact store: {error}"}
    return {}


def _read(store: ArtifactStore, sha256: str) -> bytes:
    with store.open(sha256) as file:
        return file.read()


def main() -> None:
    """Loads network and OpenGL once, reports that it is ready, then answers requests until its parent ends."""
    configure("warm")
    give_way(CHECKING)
    values = Settings()
    connection = connect()
    inbox = requests(connection)
    warm_up(values)
    library, store = Library(values.cache_dir, values.files), ArtifactStore(values.files)
    reply(connection, {"ready": True})
    for message in inbox:
        reply(connection, answer(message, library, store))


if __name__ == "__main__":
    main()
