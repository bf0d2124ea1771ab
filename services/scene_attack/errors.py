"""Defines the errors of requests and jobs, and how errors of other code, such as a plug-in's, become one of them."""

import errno
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

ERROR_LENGTH = 500
"""Characters of an error that are kept: it is logged by every process, and shown at each call of `/readyz`."""


class InvalidRequest(ValueError):
    """A request is invalid; no job was queued.

    `field` is the dotted path of the invalid part of the spec ("scene.objects.0.mesh"); `detail` states the error and
    the valid values. The API answers 422 with it, the command line exits with code 2.
    """

    def __init__(self, field: str, detail: str) -> None:
        super().__init__(f"{field}: {detail}")
        self.field = field
        self.detail = detail

    def __reduce__(self) -> tuple[type["InvalidRequest"], tuple[str, str]]:
        return type(self), (self.field, self.detail)

    @property
    def every(self) -> "tuple[InvalidRequest, ...]":
        """The errors of all invalid fields, this one first."""
        return (self,)


class InvalidFields(InvalidRequest):
    """Several fields of a request are invalid. It is the error of the first, whose detail ends in the others."""

    def __init__(self, errors: "Sequence[InvalidRequest]") -> None:
        first, *others = errors
        super().__init__(first.field, "; ".join([first.detail, *map(str, others)]))
        self._every = tuple(errors)

    def __reduce__(self) -> "tuple[type[InvalidFields], tuple[tuple[InvalidRequest, ...]]]":  # type: ignore[override]
        return InvalidFields, (self._every,)

    @property
    def every(self) -> tuple[InvalidRequest, ...]:
        """The errors of all invalid fields."""
        return self._every


class Unreadable(ValueError):
    """A file, or a part of it, is not what it should be; the message says why, in words for whoever made the file."""


DAMAGED = "it is damaged, or cut off"
"""Message where a third-party parser stops, whose own message is about itself and not about the file."""


class JobFailure(RuntimeError):
    """A valid job could not be finished. `kind` is a stable word, `detail` a sentence for a person.

    Kinds: "non-finite" (a loss, gradient or image that is not a number), "asset-missing", "out-of-memory",
    "worker-lost" (its process died too often), "timeout", "target-unreachable" (a URL's network does not answer),
    "internal".
    """

    def __init__(self, kind: str, detail: str) -> None:
        super().__init__(f"{kind}: {detail}")
        self.kind = kind
        self.detail = detail

    def __reduce__(self) -> tuple[type["JobFailure"], tuple[str, str]]:
        return type(self), (self.kind, self.detail)


class QuotaExceeded(Exception):
    """An owner has as much as it may have. `seconds` says when to try again; the API answers 429 with it."""

    def __init__(self, detail: str, seconds: float) -> None:
        super().__init__(detail)
        self.seconds = seconds


class InUse(Exception):
    """Refusal to delete something that is in use; the message says by what. The API answers 409 with it."""


class Cancelled(Exception):
    """The job was asked to stop."""


@contextmanager
def at_field(field: str) -> Iterator[None]:
    """Names the field of the request in an InvalidRequest of the block."""
    try:
        yield
    except InvalidRequest as error:
        raise InvalidRequest(field, error.detail) from error


@contextmanager
def below(part: str) -> Iterator[None]:
    """Names the field of an InvalidRequest of the block as one of `part`: "seed" becomes "generate.seed"."""
    try:
        yield
    except InvalidRequest as error:
        raise InvalidRequest(f"{part}.{error.field}", error.detail) from error


@contextmanager
def named(whose: str) -> Iterator[None]:
    """Turns any error of the block into JobFailure("internal"), which says `whose` it is: "target 'resnet'".

    An error that has a meaning for jobs already passes, and so does one of memory.
    """
    try:
        yield
    except (JobFailure, InvalidRequest, Cancelled):
        raise
    except (Exception, SystemExit) as error:
        if out_of_memory(error):
            raise
        raise JobFailure("internal", f"{whose} raised {summary(error)}") from error


def out_of_memory(error: BaseException) -> bool:
    """Returns whether an error means that memory was refused. torch has a class for it on CUDA, and none on a CPU."""
    if isinstance(error, JobFailure):
        return error.kind == "out-of-memory"
    if isinstance(error, OSError):
        return error.errno == errno.ENOMEM
    refused = isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError"
    words = ("can't allocate memory", "can't start new thread", "std::bad_alloc")
    return refused or any(word in summary(error) for word in words)


def summary(error: BaseException) -> str:
    """Returns type and message of any code's error as a line that can be printed, of at most `ERROR_LENGTH`."""
    try:
        message = " ".join(str(error).split())
    except Exception:  # the file's own class of error, and its own mistake
        message = "its message cannot be read"
    line = printable(f"{type(error).__name__}: {message}"[:ERROR_LENGTH])
    return line if len(line) < ERROR_LENGTH else f"{line[: ERROR_LENGTH - 1]}…"


def shortened(error: BaseException) -> str:
    """Returns an error's message, of at most `ERROR_LENGTH`; it may hold whatever a file says."""
    message = str(error)
    return message if len(message) <= ERROR_LENGTH else f"{message[: ERROR_LENGTH - 1]}…"


def encodable(text: str) -> str:
    """Returns the text with lone surrogates escaped: JSON may hold them ("\\ud800"), UTF-8 cannot."""
    return text.encode("utf-8", "backslashreplace").decode()


def printable(text: str) -> str:
    """Returns the text with control characters and bytes that are no UTF-8 escaped: JSON and terminals refuse them."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


_FOLDERS = re.compile(r"(?<![\w.:/])(/[^\s/'\"]+)(/[^\s/'\"]+)*/(?=[^\s/'\"])")


def without_folders(text: str) -> str:
    """Returns the text with each absolute path of this machine cut to its last name, as the API's clients may see it.

    Paths of the API, such as /v1/targets, stay: they begin with no folder of the machine.
    """
    return _FOLDERS.sub(lambda match: "" if Path(match[1]).is_dir() else match[0], text)
