"""A job of a service, as `Client` and `AsyncClient` return it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, cast

from client import operations
from client.api_client import TERMINAL, ApiClient, Event
from client.job_images import Images, opened
from client.rows import Rows

if TYPE_CHECKING:
    from PIL.Image import Image

    from client.answers import BadField, FailureView, JobSpec, JobView, Outcome, Result, State, Subset, TraceRow


class Unfinished(RuntimeError):
    """A job has no result: it has not ended, or it did not succeed. The message says which, and why."""


class JobFields:
    """What is known of a job without asking the service again; `data` is its JSON, the JobView of openapi.yaml."""

    def __init__(self, data: JobView) -> None:
        self.data = data

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.id} {self.state}: {self.data['name']}, {self.data['attack']}>"

    @property
    def id(self) -> str:
        """The job's id, 32 hexadecimal digits."""
        return self.data["id"]

    @property
    def state(self) -> State:
        """The state when the service was last asked."""
        return self.data["state"]

    @property
    def ended(self) -> bool:
        """Whether the job has ended: it succeeded, failed, was rejected or cancelled."""
        return self.state in TERMINAL

    @property
    def spec(self) -> JobSpec:
        """The request, with the values of all fields filled in."""
        return cast("JobSpec", self.data["spec"])

    @property
    def outcome(self) -> Outcome | None:
        """The part of the result that lists show; None until the job has succeeded."""
        return self.data["outcome"]

    @property
    def failure(self) -> FailureView | None:
        """Why the job failed; None if it did not."""
        return self.data["failure"]

    @property
    def errors(self) -> list[BadField]:
        """The invalid fields of a rejected job."""
        return self.data.get("errors", [])

    @property
    def result(self) -> Result:
        """The whole result, of a re-rendering a RerenderingView. Raises Unfinished unless the job succeeded."""
        if self.data["result"] is None:
            why = self.data["failure"]
            said = "; ".join(f"{one['field']}: {one['detail']}" for one in self.errors)
            reason = said if why is None else f"{why['kind']}: {why['detail']}"
            hint = reason if self.ended else "call wait() first"
            raise Unfinished(f"job {self.id} is {self.state}" + (f": {hint}" if hint else ""))
        return cast("Result", self.data["result"])

    @property
    def verified(self) -> bool:
        """Whether the stored perturbation, rendered afresh and rounded to 8 bits, fools the network."""
        return self.result["verified"]

    @property
    def trace(self) -> Rows[TraceRow]:
        """The steps of the attack: a row for each, with its queries, answer, confidence and perceptibility."""
        return Rows(self.result["trace"])

    @property
    def subsets(self) -> Rows[Subset]:
        """The subsets of the attacked groups: a row for each, with the answer to that part of the change alone."""
        return Rows(self.result["subsets"])


class Job(JobFields):
    """A job of a service."""

    def __init__(self, data: JobView, api: ApiClient) -> None:
        super().__init__(data)
        self._api = api

    @cached_property
    def images(self) -> Images[Image]:
        """The images before and after. Reading one raises ApiError (404) if the job has no result."""
        return Images(cache(lambda name: opened(self.file(name))))

    def file(self, name: str) -> bytes:
        """The bytes of one of the job's files, e.g. "perturbation.safetensors"."""
        return self._api.call(operations.download_artifact(self.id, name))

    def files(self) -> list[str]:
        """The names of the job's files; none until it has succeeded."""
        return [one["name"] for one in self._api.call(operations.list_artifacts(self.id))["items"]]

    def download(self, folder: Path | str) -> list[Path]:
        """Writes all files of the job into a folder, as `scene-attack run --out` does, and returns their paths."""
        paths = []
        for name in self.files():
            path = Path(folder) / Path(name).name  # a service can name no file outside the folder
            self._api.download_artifact(self.id, name, path)
            paths.append(path)
        return paths

    def refresh(self) -> Job:
        """Asks the service for the job's state and result; returns this job."""
        self.data = self._api.call(operations.get_job(self.id))
        return self

    def watch(self) -> Iterator[Event]:
        """The job's events, each once and in order, until it has ended; a dropped connection is taken up again."""
        yield from self._api.stream_job_events(self.id)
        self.refresh()

    def wait(self) -> Job:
        """Waits until the job has ended; returns this job, with its result if it succeeded."""
        if not self.ended:
            for _ in self.watch():
                pass
        return self.refresh() if self.ended and self.data["result"] is None else self

    def cancel(self) -> Job:
        """Asks the job to stop; returns this job. One that has ended stays as it is."""
        self._api.call(operations.cancel_job(self.id))
        return self.refresh()

    def retry(self) -> Job:
        """Queues the job's request again; returns the new job."""
        return Job(self._api.call(operations.retry_job(self.id)), self._api)

    def continue_(self) -> Job:
        """Queues a job that goes on from the checkpoint of this one, which was cancelled or failed; returns it.

        ApiError with status 409 if it has not ended so, or ended before its first checkpoint.
        """
        return Job(self._api.call(operations.continue_job(self.id)), self._api)

    def delete(self) -> None:
        """Deletes the job with its files. ApiError with status 409 if it has not ended, or a campaign refers to it."""
        self._api.call(operations.delete_job(self.id))
