"""A target that answers over HTTP: it gets images as PNG and returns scores. docs/targets.md describes the protocol."""

import base64
import hashlib
import io
import json
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from threading import Event, Timer
from typing import Any

import httpx
import torch
from PIL import Image
from torch import Tensor
from torch.nn import functional as F

from scene_attack.errors import JobFailure, Unreadable
from scene_attack.targets.custom.card import AllowList

MOST_IMAGES = 32
"""Maximum number of images of a request."""
MOST_SCORE_BYTES = 64
"""Maximum number of bytes of a score in an answer: a number as JSON, with the characters around it."""
_OTHER_BYTES = 2**16
_CONNECT_SECONDS, _READ_SECONDS = 5.0, 30.0
_AGAIN = (429, 502, 503, 504)


class _Refused(Exception):
    """The endpoint could not be asked this time; it may answer if it is asked again."""


@dataclass
class Endpoint:
    """A network behind a URL; implements `Target`. It has no gradients, and sees images of 8 bits."""

    name: str
    url: str
    labels: tuple[str, ...]
    input_size: tuple[int, int]
    probabilities: bool
    """Whether it returns probabilities, of which the logarithm is taken."""
    weights_sha256: str
    """SHA-256 (hex) of its card, since the network itself cannot be seen."""
    allowed: AllowList
    """The operator's lists, which the URL and the addresses of its host are checked against."""
    waits: tuple[float, ...] = (0.5, 2.0)
    """Seconds before each further try."""
    most_seconds: float = 60.0
    """Longest time from the connection to the last byte of an answer."""
    differentiable: bool = field(default=False, init=False)
    scores_only: str = field(default="a URL answers with scores only", init=False)
    """The reason for which it has no gradients."""

    def __post_init__(self) -> None:
        reason = self.allowed.endpoint_refusal(self.url)
        if reason is not None:
            raise Unreadable(reason)
        self._socket: socket.socket | None = None
        self._client = httpx.Client(
            timeout=httpx.Timeout(_READ_SECONDS, connect=_CONNECT_SECONDS), trust_env=False, follow_redirects=False
        )

    @property
    def backend(self) -> str:
        """The address."""
        return f"endpoint {self.url}"

    @torch.no_grad()
    def logits(self, images: Tensor) -> Tensor:
        """Returns scores [B, K] of images [B, H, W, 3] in [0,1], which are resized and rounded to 8 bits.

        Raises JobFailure("target-unreachable") if it does not answer, and JobFailure("internal") for an answer that
        breaks the protocol.
        """
        x = images.detach().to("cpu", torch.float32).permute(0, 3, 1, 2)
        if tuple(x.shape[-2:]) != self.input_size:
            x = F.interpolate(x, self.input_size, mode="bilinear", antialias=True)
        pixels = (x.permute(0, 2, 3, 1) * 255).round().clamp(0, 255).to(torch.uint8)
        portions: tuple[Tensor, ...] = pixels.split(MOST_IMAGES)  # type: ignore[no-untyped-call]
        scores = torch.cat([self._ask(portion) for portion in portions])
        if self.probabilities:
            scores = scores.clamp_min(torch.finfo(torch.float32).tiny).log()
        return scores.to(images.device)

    def _ask(self, pixels: Tensor) -> Tensor:
        body = json.dumps({"images": [_png(image) for image in pixels]}).encode()
        for wait in (*self.waits, None):
            try:
                return self._scores(self._answer(body, len(pixels)), len(pixels))
            except (_Refused, OSError, httpx.TransportError) as error:
                if wait is None:
                    tries = len(self.waits) + 1
                    reason = str(error) or type(error).__name__
                    detail = f"{self.url} did not answer in {tries} tries: {reason}"
                    raise JobFailure("target-unreachable", detail) from error
                time.sleep(wait)
        raise AssertionError

    def _answer(self, body: bytes, count: int) -> bytes:
        """The body of the answer to one request."""
        url = httpx.URL(self.url)
        headers = {
            "Host": url.netloc.decode(),
            "Content-Type": "application/json",
            "Accept": "application/json",
            "Accept-Encoding": "identity",
            "Idempotency-Key": hashlib.sha256(body).hexdigest(),  # a repeated request is the same request
        }
        place = url.copy_with(host=self.allowed.resolve(url.host, url.port or (443 if url.scheme == "https" else 80)))
        extensions = {"sni_hostname": url.host, "trace": self._keep_socket}
        # httpx limits the time between two parts of an answer; a head that comes byte by byte would never end
        with (
            self._time_limit(),
            self._client.stream("POST", place, content=body, headers=headers, extensions=extensions) as response,
        ):
            if response.status_code in _AGAIN:
                raise _Refused(f"status {response.status_code}")
            if response.status_code != httpx.codes.OK:
                kind = "a redirect, which is not followed" if response.is_redirect else "not 200"
                raise self._broken(f"status {response.status_code}, {kind}")
            if response.headers.get("Content-Encoding", "identity") != "identity":
                raise self._broken("a compressed body, which it was not asked for")
            most = _OTHER_BYTES + MOST_SCORE_BYTES * count * len(self.labels)
            return b"".join(self._portions(response, most))

    def _keep_socket(self, event: str, info: dict[str, Any]) -> None:
        """Keeps the socket of a new connection, which httpcore reports."""
        if event in ("connection.connect_tcp.complete", "connection.start_tls.complete"):
            self._socket = info["return_value"].get_extra_info("socket")

    @contextmanager
    def _time_limit(self) -> Iterator[None]:
        """Shuts the connection down once the time is over. Raises _Refused if it was."""
        over = Event()

        def end() -> None:
            over.set()
            if self._socket is not None:
                with suppress(OSError):
                    self._socket.shutdown(socket.SHUT_RDWR)

        timer = Timer(self.most_seconds, end)
        timer.daemon = True
        timer.start()
        try:
            yield
        except httpx.TransportError:
            if not over.is_set():
                raise
        finally:
            timer.cancel()
        if over.is_set():  # also where the end of the connection looks like that of the answer
            raise _Refused(f"no whole answer in {self.most_seconds:g} s")

    def _portions(self, response: httpx.Response, most: int) -> Iterator[bytes]:
        total = 0
        for portion in response.iter_raw():
            total += len(portion)
            if total > most:
                raise self._broken(f"more than {most:,} bytes")
            yield portion

    def _scores(self, data: bytes, count: int) -> Tensor:
        try:
            rows: Any = json.loads(data)["scores"]
            scores = torch.tensor(rows, dtype=torch.float32)
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise self._broken('no JSON {"scores": [[…], …]} of numbers') from error
        if scores.shape != (count, len(self.labels)):
            expected = f"{count} lists of {len(self.labels)}"
            raise self._broken(f"scores of shape {list(scores.shape)} for {count} images; {expected} are due")
        return scores

    def _broken(self, what: str) -> JobFailure:
        return JobFailure("internal", f"{self.url} answered with {what}")


def _png(pixels: Tensor) -> str:
    buffer = io.BytesIO()
    Image.fromarray(pixels.numpy()).save(buffer, "PNG", compress_level=1)
    return base64.b64encode(buffer.getvalue()).decode()
