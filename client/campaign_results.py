"""The results and the attacked images of a campaign, from the folder of a run or from a service."""

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from services.errors import InvalidRequest
from services.pipeline.result import Result

if TYPE_CHECKING:
    from client.api_client import ApiClient

IMAGES = ("original.png", "attacked.png")


def folder_results(folder: Path) -> Iterator[tuple[Result, Path]]:
    """The result of each job in the folder of `campaign run` and the folder of its images, in the table's order.

    Raises InvalidRequest("source") if the folder is not one.
    """
    import json

    try:
        requests = json.loads((folder / "jobs.json").read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise InvalidRequest(
            "source", f"{folder} is not the folder of a campaign that has been run: {error}"
        ) from error
    for request in requests:
        place = folder / "jobs" / str(request)
        if (place / "result.json").exists():
            yield Result.model_validate_json((place / "result.json").read_bytes()), place


def service_results(client: "ApiClient", campaign_id: str) -> Iterator[tuple[Result, Path]]:
    """The result of each job that succeeded, and a folder with its images that lasts until the next result."""
    for planned in _planned(client, campaign_id):
        if planned["state"] != "succeeded":
            continue
        with TemporaryDirectory() as folder:
            for name in IMAGES:
                client.download_artifact(planned["job"], name, Path(folder) / name)
            yield Result.model_validate(client.get_job(planned["job"])["result"]), Path(folder)


def _planned(client: "ApiClient", campaign_id: str) -> Iterator[dict[str, Any]]:
    after: int | None = -1
    while after is not None:
        page = client.list_campaign_jobs(campaign_id, after)
        yield from page["items"]
        after = page["next"]
