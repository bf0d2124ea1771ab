"""Options of the engine: where it keeps files, on which device and OpenGL platform it computes, what it loads besides
its own parts, and how large a file may be. The defaults work on a laptop.
"""

import os
from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator

from scene_attack.addresses import endpoint_mistake

PREFIX = "SCENE_ATTACK_"
"""Beginning of the names of environment variables."""


class Options(BaseModel):
    """What may be chosen of the engine. A process has one value of most of them (`scene_attack.process`)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    cache: Path = Field(
        default=Path("~/.cache/scene-attack"), description="downloaded and derived files; safe to delete"
    )
    data: Path = Field(default=Path("~/.local/share/scene-attack"), description="database, artifacts, uploaded assets")
    artifact_url: str | None = Field(
        default=None,
        description="URL of a store for artifacts and uploads, s3://bucket/folder; default: the data directory",
    )
    device: str = Field(
        default="auto",
        pattern=r"^(auto|cpu|cuda(:[0-9]{1,2})?)$",
        description="where networks and the torch renderer compute: auto (CUDA if there is one), cpu, cuda, cuda:N",
    )
    threads: int = Field(
        default=2, ge=1, le=256, description="torch threads of a job process; part of the backend string"
    )
    without_plugins: tuple[str, ...] | str = Field(
        default=(),
        description="names of installed plug-ins to leave out, separated by commas; `scene-attack doctor` lists them",
    )
    targets: Path | None = Field(
        default=None,
        description="folder with networks of your own, one folder each with a `card.json`; docs/targets.md",
    )
    target_factories: str | None = Field(
        default=None,
        description="`module:callable` of each function that a card may name as its `factory`, separated by commas",
    )
    target_endpoints: str | None = Field(
        default=None,
        description="each URL that a card may name as its `endpoint`, and each private IP address that such a URL's "
        "host may have, separated by commas",
    )
    gl: Literal["auto", "egl", "osmesa"] = Field(
        default="auto", description="OpenGL platform; auto tries EGL, then OSMesa"
    )
    kernels: Literal["auto", "v4", "v3", "torch"] = Field(
        default="auto",
        description="what runs inner loops on a CPU: compiled kernels for x86-64-v4 (AVX-512) or x86-64-v3 (AVX2), or "
        "torch; auto takes the first of them that is there and that the processor can run",
    )
    max_upload_bytes: int = Field(default=32 * 2**20, ge=1, description="largest mesh upload")
    max_faces: int = Field(default=300_000, ge=1, description="largest mesh, in triangles")

    @field_validator("without_plugins")
    @classmethod
    def _each_name(cls, value: tuple[str, ...] | str) -> tuple[str, ...]:
        return tuple(sorted(listed(value))) if isinstance(value, str) else value

    @field_validator("target_endpoints")
    @classmethod
    def _can_be_reached(cls, value: str | None) -> str | None:
        for part in sorted(listed(value)):
            refusal = endpoint_mistake(part)
            if refusal is not None:
                raise ValueError(f"{part!r} can never match: {refusal}")
        return value

    @field_validator("cache", "data", "targets")
    @classmethod
    def _has_a_home(cls, value: Path | None) -> Path | None:
        try:
            if value is not None:
                value.expanduser()
        except RuntimeError as error:
            raise ValueError(f"{value}: there is no such user") from error
        return value

    @property
    def cache_dir(self) -> Path:
        """The cache directory, absolute."""
        return self.cache.expanduser().resolve()

    @property
    def data_dir(self) -> Path:
        """The data directory, absolute."""
        return self.data.expanduser().resolve()

    @property
    def files(self) -> Path | str:
        """Location of artifacts and uploads: the URL of a store, or the data directory."""
        return self.artifact_url or self.data_dir

    @property
    def target_folder(self) -> Path | None:
        """The folder with networks of one's own, absolute; None if there is none."""
        return None if self.targets is None else self.targets.expanduser().resolve()

    @property
    def allowed_factories(self) -> frozenset[str]:
        """The factories that cards may name."""
        return listed(self.target_factories)

    @property
    def allowed_endpoints(self) -> frozenset[str]:
        """The URLs that cards may name, and the private addresses that these may have."""
        return listed(self.target_endpoints)

    def environ(self) -> dict[str, str]:
        """Returns the environment variables that give a child process these options."""
        values = {name: getattr(self, name) for name in type(self).model_fields}
        return {
            f"{PREFIX}{name.upper()}": ",".join(value) if isinstance(value, tuple) else str(value)
            for name, value in values.items()
            if value not in (None, ())
        }

    @classmethod
    def of_environment(cls) -> Self:
        """The options of the environment's variables, SCENE_ATTACK_ and the option's name; an empty variable is none.

        Raises pydantic.ValidationError.
        """
        variables = {name: os.environ.get(f"{PREFIX}{name.upper()}") for name in cls.model_fields}
        return cls.model_validate({name: value for name, value in variables.items() if value})


def listed(text: str | None) -> frozenset[str]:
    """The entries of a list that is written with commas."""
    return frozenset(part.strip() for part in (text or "").split(",") if part.strip())


DEFAULTS = Options()
"""The options of whoever chooses none."""
