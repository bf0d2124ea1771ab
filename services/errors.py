"""The two ways a request can go wrong: it was bad, or running it failed."""


class InvalidRequest(ValueError):
    """The caller asked for something that cannot be done; nothing was queued.

    `field` is the dotted path of the part of the spec that was wrong ("scene.objects.0.mesh"), `detail` says what was
    wrong and what would be right. The API answers 422 with it, the command line exits with code 2.
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
