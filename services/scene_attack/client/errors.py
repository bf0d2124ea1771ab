"""The errors of the clients and their texts: a refused request, or a service that did not answer."""

from collections.abc import Mapping
from typing import Any
from urllib.parse import urlsplit

import httpx

START = "start one with scene-attack serve, or name it with --url"


class ApiError(Exception):
    """A request that the service refused, with the HTTP status and the problem document; its text is one line."""

    def __init__(self, status: int, problem: Mapping[str, Any]) -> None:
        self.status = status
        self.problem = dict(problem)
        super().__init__(
            "; ".join(self.fields) or str(problem.get("detail") or problem.get("title") or f"HTTP {status}")
        )

    @property
    def fields(self) -> list[str]:
        """Each invalid field with what is wrong with it; empty for a refusal that names none."""
        return [f"{wrong.get('field')}: {wrong.get('detail')}" for wrong in self.problem.get("errors") or []]


class Unfinished(RuntimeError):
    """A job has no result: it has not ended, or it did not succeed. The message gives the state and the reason."""


def refusal(response: httpx.Response) -> ApiError:
    """The error of a response that has been read."""
    try:
        problem = response.json()
    except ValueError:
        problem = None
    if isinstance(problem, dict):
        return ApiError(response.status_code, problem)
    message = f"HTTP {response.status_code} from {response.url}, which is no answer of this service; check --url"
    if response.status_code == httpx.codes.SERVICE_UNAVAILABLE:  # of the server itself, or of a proxy
        message = f"the service at {_origin(response.request)} is busy (HTTP 503); try again later"
    return ApiError(response.status_code, {"detail": message})


def why(error: httpx.HTTPError) -> str:
    """Describes an error between this machine and a service, and the remedy."""
    reason = (str(error) or type(error).__name__).strip()
    try:
        origin = _origin(error.request)
    except RuntimeError:  # an error of the client's own has no request
        origin = ""
    other = origin.replace("https://", "http://") if origin.startswith("https") else f"https{origin[4:]}"
    if "WRONG_VERSION_NUMBER" in reason or "record layer failure" in reason:
        return f"{origin} does not speak https; try --url {other}"
    if "CERTIFICATE_VERIFY_FAILED" in reason:
        return f"the certificate of {origin} is not trusted ({reason}); SSL_CERT_FILE names one that is"
    if "Name or service not known" in reason or "No address associated" in reason or "name resolution" in reason:
        return f"there is no host {urlsplit(origin).hostname!r}; name the service with --url"
    if isinstance(error, httpx.DecodingError):
        return f"{reason}; is --url the address of a service?"
    if isinstance(error, httpx.RemoteProtocolError) and origin.startswith("http:"):
        return f"no answer from {origin} ({reason}); if it speaks https, try --url {other}"
    return f"no answer from {origin or 'the service'} ({reason}); {START}"


def _origin(request: httpx.Request) -> str:
    return f"{request.url.scheme}://{request.url.netloc.decode('ascii')}"
