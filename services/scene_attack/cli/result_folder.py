"""Keeps a folder of one job's files from being overwritten by another job's."""

import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scene_attack.errors import InvalidRequest

if TYPE_CHECKING:
    from scene_attack.client.schemas import ArtifactView
    from scene_attack.runs.spec import Goal, JobSpec

REMEDY = "name another folder, or remove this one"


def check_free(
    folder: Path, spec: "JobSpec", field: str = "--out", network: Sequence[str | None] | None = None
) -> None:
    """Raises InvalidRequest(field) if the folder holds the result or the checkpoint of another job than `spec`,
    or is a file.

    network: the hashes of weights and card, if it is a network that the request does not name, and nothing if they are
    not known; a result of another network is another job's, too.
    """
    from scene_attack.runs.spec import attack_name, job_name

    for name, what in (("checkpoint.json", "the checkpoint"), ("result.json", "the result")):
        try:
            data = json.loads((folder / name).read_bytes())
            stored = data["spec"] if name == "result.json" else data
            whose = f"{job_name(stored)}, {attack_name(stored)}"
        except FileNotFoundError:
            continue
        except NotADirectoryError as error:
            raise InvalidRequest(field, f"{folder} is a file; name a folder") from error
        except (ValueError, KeyError, TypeError) as error:
            raise InvalidRequest(field, f"{folder} holds a {name} that is no job's; {REMEDY}") from error
        if not _same(stored, spec):
            raise InvalidRequest(field, f"{folder} holds {what} of another job ({whose}); {REMEDY}")
        made_by = data.get("provenance", {})
        if network is not None and (made_by.get("weights_sha256"), made_by.get("card_sha256")) != tuple(network):
            raise InvalidRequest(field, f"{folder} holds {what} of another network ({whose}); {REMEDY}")


def prepare_folder(folder: Path, field: str = "--out") -> None:
    """Makes the folder. Raises InvalidRequest(field) if it cannot be made or written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidRequest(field, f"cannot make the directory {folder}: {error.strerror}") from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InvalidRequest(field, f"the directory {folder} cannot be written; name another one")


def check_finished(folder: Path) -> None:
    """Raises InvalidRequest("directory") unless the folder has a result, whose other files are read later."""
    path = folder / "result.json"
    if folder.suffix == ".zip" and folder.is_file():
        raise InvalidRequest("directory", f"{folder} is a zip file; unpack it, and name the folder that is in it")
    if not path.is_file():
        raise InvalidRequest("directory", f"{folder} is not the output of a finished job: there is no file {path}")


def check_same_files(folder: Path, artifacts: "Iterable[ArtifactView]") -> None:
    """Raises InvalidRequest("--out") if the folder's result is another one than that of these files of a job."""
    digest = next((file.sha256 for file in artifacts if file.name == "result.json"), None)
    path = folder / "result.json"
    if path.exists() and hashlib.sha256(path.read_bytes()).hexdigest() != digest:
        raise InvalidRequest("--out", f"{folder} holds the result of another job; {REMEDY}")


def _same(stored: Mapping[str, Any], spec: "JobSpec") -> bool:
    """Whether a stored spec is this one, in which the goal's labels may not have been filled in yet."""
    from scene_attack.runs.spec import parse

    try:
        stored_spec = parse(stored)
    except InvalidRequest:  # of a version with other fields
        return False
    stored_fields, asked = (job.model_dump(mode="json", exclude={"goal"}) for job in (stored_spec, spec))
    return stored_fields == asked and _same_goal(stored_spec.goal, spec.goal)


def _same_goal(stored: "Goal", asked: "Goal") -> bool:
    if stored.least_confidence != asked.least_confidence:
        return False
    if (stored.reach is None) != (asked.reach is None):
        return False
    return all(
        _names(getattr(asked, field)) <= _names(getattr(stored, field)) or not _names(getattr(stored, field))
        for field in ("truth", "leave", "reach")
    )


def _names(labels: Any) -> set[str]:
    """The labels that are named; an index is the same label as a name that only the network knows."""
    return {label for label in (labels if isinstance(labels, tuple) else (labels,)) if isinstance(label, str)}
