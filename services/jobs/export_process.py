"""The process that makes exports and `.glb` files of finished jobs, and of assets, for the API.

It is one of its own: drawing the normals of a scene needs OpenGL, which only one thread of a process may use, and a
large mesh must not delay other answers.
"""

import resource
from functools import partial
from pathlib import Path
from typing import Any

import torch

from services.confinement.system_calls import forbid_new_privileges
from services.errors import InvalidRequest, JobFailure, out_of_memory
from services.export import ASSET, BUNDLE
from services.export.asset_glb import asset_glb
from services.export.bundle import read_finished, write_bundle
from services.export.destinations import zipped
from services.jobs.artifacts import ArtifactStore, Damaged
from services.jobs.child import OUT_OF_MEMORY, connect, reply, requests
from services.jobs.memory_limit import limit_memory
from services.jobs.outages import outage_of
from services.logs import configure, logger
from services.pipeline.extensions import set_up
from services.scenes.library import Library
from services.settings import Settings

log = logger(__name__)


def answer(message: dict[str, Any], store: ArtifactStore, library: Library) -> dict[str, Any]:
    """Makes what a message asks for: {"what": BUNDLE, "before" or "after", "job": id, "artifacts": {name: sha256},
    "out": path} or {"what": ASSET, "mesh": name, "out": path}. Writes the file `out` and answers {}, {"refused":
    sentence}, {"failed": sentence} or OUT_OF_MEMORY.
    """
    files = {name: partial(_read, store, sha256) for name, sha256 in message.get("artifacts", {}).items()}
    try:
        if message["what"] == ASSET:
            Path(message["out"]).write_bytes(asset_glb(message["mesh"], library))
        elif message["what"] == BUNDLE:
            with Path(message["out"]).open("wb") as out, zipped(out, f"scene-attack-{message['job'][:8]}") as write:
                write_bundle(files, library, write, message["job"])
        else:
            Path(message["out"]).write_bytes(read_finished(files, library).glb(message["what"]))
    except InvalidRequest as error:
        return {"refused": f"{error.field}: {error.detail}"}
    except JobFailure as error:
        return {"refused": error.detail}
    except (FileNotFoundError, Damaged) as error:
        return {"refused": f"a file of the job is gone from the artifact store: {error}"}
    except Exception as error:
        outage = outage_of(error)
        if outage is not None:
            return {"failed": outage.detail}
        if out_of_memory(error):
            return OUT_OF_MEMORY
        log.error("export failed", exc_info=error)
        return {"failed": "the service's log says why"}
    return {}


def _read(store: ArtifactStore, sha256: str) -> bytes:
    with store.open(sha256) as file:
        return file.read()


def main() -> None:
    """Answers requests until its parent ends."""
    configure("export")
    values = Settings()
    set_up(values)
    connection = connect()
    inbox = requests(connection)
    limit_memory(values)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    forbid_new_privileges()
    torch.set_num_threads(values.threads)
    store, library = ArtifactStore(values.files), Library(values.cache_dir, values.files)
    reply(connection, {"ready": True})
    for message, _ in inbox:
        reply(connection, answer(message, store, library))


if __name__ == "__main__":
    main()
