"""Defines the errors of requests and jobs: an invalid request, a failed job, a cancelled job."""


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


class JobFailure(RuntimeError):
    """A valid job could not be finished. `kind` is a stable word, `detail` a sentence for a person.

    Kinds: "non-finite" (a loss, gradient or image that is not a number), "asset-missing", "out-of-memory",
    "worker-lost" (its process died too often), "timeout", "internal".
    """

    def __init__(self, kind: str, detail: str) -> None:
        super().__init__(f"{kind}: {detail}")
        self.kind = kind
        self.detail = detail

    def __reduce__(self) -> tuple[type["JobFailure"], tuple[str, str]]:
        return type(self), (self.kind, self.detail)


class Cancelled(Exception):
    """The job was asked to stop."""
