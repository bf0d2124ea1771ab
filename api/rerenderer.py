"""The process that re-renders images. It is one of its own, so that a fit does not delay the check of requests."""

import base64
from io import BytesIO
from typing import Any

from api.warm_process import TooSlow, Unavailable, WarmProcess
from services.analysis.requests import RerenderingRequest
from services.errors import InvalidRequest
from services.jobs.child import ChildDied, OutOfMemory
from services.pipeline.spec import JobSpec
from services.settings import Settings

SECONDS = 300.0
"""Longest time for re-rendering an image, after which the process is killed."""


class Rerenderer:
    """A warm process that handles one image at a time. It starts with the first request and stays."""

    def __init__(self, settings: Settings) -> None:
        self._process = WarmProcess(settings)
        self._busy = False

    def close(self) -> None:
        """Ends the process."""
        self._process.close()

    async def rerender(self, image: bytes, spec: JobSpec, fit: RerenderingRequest) -> dict[str, Any]:
        """Returns {"rerendering": record, "png": the rendering in base64}.

        Raises InvalidRequest naming the field, and Unavailable, also while another image is re-rendered.
        """
        if self._busy:
            raise Unavailable("another image is being re-rendered; this service does one at a time")
        self._busy = True
        try:
            request = {"spec": spec.model_dump(mode="json"), "fit": fit.model_dump(mode="json")}
            return await self._process.ask({"rerender": request}, BytesIO(image), SECONDS)
        except OutOfMemory as error:
            raise Unavailable(f"the image could not be re-rendered: it needs {error}") from error
        except (ChildDied, TooSlow) as error:
            detail = f"the fit did not end within {SECONDS:g} seconds and the memory allowed; ask for fewer"
            raise InvalidRequest("fit.steps", detail) from error
        finally:
            self._busy = False


def decoded(text: str) -> bytes:
    """The bytes of base64 text. Raises ValueError."""
    return base64.b64decode(text, validate=True)
