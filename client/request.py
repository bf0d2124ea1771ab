"""A request of an operation of openapi.yaml, with the type of its answer, before it is sent."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Literal, TypeVar
from urllib.parse import quote

import httpx

Answer = TypeVar("Answer")
Device = Literal["cuda", "cpu"]
CHECK_SECONDS = 300.0
"""The service may take so long to check a request; the first request waits for a process to warm up."""


@dataclass(frozen=True)
class Request(Generic[Answer]):
    """A request of an operation of openapi.yaml: `route` is its path there, whose names in braces are in `path`."""

    method: str
    route: str
    path: Mapping[str, str] = field(default_factory=dict)
    params: Mapping[str, Any] = field(default_factory=dict)
    headers: Mapping[str, str | None] = field(default_factory=dict)
    json: Any = None
    files: Sequence[tuple[str, bytes]] = ()
    form: Mapping[str, Any] = field(default_factory=dict)
    seconds: float | None = None
    """Longest wait for the answer; None for the client's own."""

    @property
    def address(self) -> str:
        """The path with its names filled in."""
        return self.route.format_map({name: quote(value, safe="") for name, value in self.path.items()})

    def arguments(self) -> dict[str, Any]:
        """The request as the arguments of `httpx.Client.request`."""
        found: dict[str, Any] = {"method": self.method, "url": self.address}
        if params := given(self.params):
            found["params"] = params
        if headers := given(self.headers):
            found["headers"] = headers
        if self.json is not None:
            found["json"] = self.json
        if self.files:
            found |= {"files": [("file", one) for one in self.files], "data": given(self.form)}
        if self.seconds is not None:
            found["timeout"] = self.seconds
        return found


def given(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values that are not None."""
    return {name: value for name, value in values.items() if value is not None}


class ApiError(Exception):
    """A request that the service refused, with the HTTP status and the problem document; its text is one line."""

    def __init__(self, status: int, problem: Mapping[str, Any]) -> None:
        self.status = status
        self.problem = dict(problem)
        said = [f"{item.get('field')}: {item.get('detail')}" for item in problem.get("errors") or []]
        super().__init__("; ".join(said) or str(problem.get("detail") or problem.get("title") or f"HTTP {status}"))


def refusal(response: httpx.Response) -> ApiError:
    """The error of a response that has been read."""
    try:
        problem = response.json()
    except ValueError:
        problem = None
    if not isinstance(problem, dict):
        said = f"HTTP {response.status_code} from {response.url}, which is no answer of this service; check --url"
        problem = {"detail": said}
    return ApiError(response.status_code, problem)


def object_of(response: httpx.Response) -> dict[str, Any]:
    """The JSON object in a response. Raises ApiError if the service refused, httpx.DecodingError if it is none."""
    if response.is_error:
        raise refusal(response)
    if response.has_redirect_location:  # following it could send the key elsewhere
        said = f"{response.url} sends on to {response.headers['location']}, which is not followed"
        raise httpx.DecodingError(said, request=response.request)
    try:
        data = response.json()
    except ValueError as error:
        kind = response.headers.get("content-type", "nothing that says what it is")
        said = f"{response.url} answered HTTP {response.status_code} with {kind}, not JSON"
        raise httpx.DecodingError(said, request=response.request) from error
    if not isinstance(data, dict):
        said = f"{response.url} answered a JSON {type(data).__name__}, not an object"
        raise httpx.DecodingError(said, request=response.request)
    return data


def answer_of(response: httpx.Response) -> Any:
    """The answer in a response: an object, a text, bytes, or None where there is no content. Raises as `object_of`."""
    if response.status_code == httpx.codes.NO_CONTENT:
        return None
    kind = response.headers.get("content-type", "")
    if not response.is_success or kind.startswith(("application/json", "text/html")):
        return object_of(response)
    return response.text if kind.startswith("text/") else response.content
