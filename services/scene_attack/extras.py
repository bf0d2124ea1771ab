"""Packages that a plain installation lacks: an extra installs them, and whoever needs one is told which extra."""

from collections.abc import Iterator
from contextlib import contextmanager

from scene_attack.errors import InvalidRequest

MODULES = {
    "service": (
        "alembic",
        "fastapi",
        "jinja2",
        "markupsafe",
        "prometheus_client",
        "pydantic_settings",
        "python_multipart",
        "redis",
        "rq",
        "sqlalchemy",
        "starlette",
        "uvicorn",
        "uvloop",
        "yaml",
    ),
    "formats": ("Imath", "OpenEXR", "collada", "lxml", "networkx"),
    "export": ("OpenEXR", "jinja2", "matplotlib"),
    "mitsuba": ("drjit", "mitsuba"),
    "onnx": ("google", "onnx", "onnxruntime"),
    "pandas": ("pandas",),
    "postgresql": ("psycopg",),
    "s3": ("botocore", "fsspec", "s3fs"),
}
"""The modules that code imports only where an extra is asked for, by the extra."""


class MissingExtra(InvalidRequest):
    """What was asked for needs packages that are not installed: an error of this request, as another needs them not."""


@contextmanager
def extra(name: str, subject: str, field: str = "installation") -> Iterator[None]:
    """Turns the error of a missing module of the extra `name` into MissingExtra(field): that the subject needs the
    extra, and how it is installed. Any other error passes.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in MODULES[name]:
            raise
        command = f'pip install "scene-attack[{name}]"'
        raise MissingExtra(field, f'{subject} needs the extra "{name}": {command}') from error
