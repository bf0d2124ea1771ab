"""Packages that a plain installation lacks: an extra installs them, and whoever needs one is told which extra."""

from collections.abc import Iterator
from contextlib import contextmanager

from scene_attack.errors import InvalidRequest

EXTRAS = ("service", "questions", "accuracy", "onnx", "formats", "export", "postgresql", "s3", "maite", "pandas")
"""The extras of pyproject.toml that a user may need."""


class MissingExtra(InvalidRequest):
    """What was asked for needs packages that are not installed. `field` is what was asked for.

    It is an error of the request, because another request needs no such package. Its text has no field in front.
    """

    def __str__(self) -> str:
        return self.detail


@contextmanager
def extra(name: str, subject: str) -> Iterator[None]:
    """Turns an ImportError of the block into MissingExtra: "<subject> needs the extra <name>", and how to install it.

    `name` is one of EXTRAS. A module of this project that is missing is no missing package: its error passes.
    """
    assert name in EXTRAS
    try:
        yield
    except ImportError as error:
        if (error.name or "").startswith("scene_attack"):
            raise
        command = f'pip install "scene-attack[{name}]"'
        raise MissingExtra(subject, f'{subject} needs the extra "{name}": {command}') from error
