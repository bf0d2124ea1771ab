"""The process that re-renders images. It is one of its own, so that a fit does not delay the check of requests."""

import base64
from typing import Any

from api.preflight import Preflight, Unavailable
from services.analysis.requests import RerenderingRequest
from services.pipeline.spec import JobSpec
from services.settings import Settings


class Rerenderer:
    """A warm process that handles one image at a time. It starts with the first request and stays."""

    def __init__(self, settings: Settings) -> None:
        self._process = Preflight(settings)
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
            return await self._process.rerender(request, image)
        finally:
            self._busy = False


def decoded(text: str) -> bytes:
    """The bytes of base64 text. Raises ValueError."""
    return base64.b64decode(text, validate=True)
