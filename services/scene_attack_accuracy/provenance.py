"""The provenance of a report: how, when and where its figures were made."""

import os
from datetime import UTC, datetime

import torch
from pydantic import BaseModel, ConfigDict, Field

from scene_attack.process import versions
from scene_attack.rendering.kernels import compiled
from scene_attack.rendering.opengl.context import gl_backend

PACKAGES = (
    "scene-attack",
    "torch",
    "numpy",
    "scipy",
    "pyrender-maintained",
    "PyOpenGL",
    "trimesh",
    "OpenEXR",
)
"""The packages on which figures depend."""


def backend() -> str:
    """The devices, kernels and OpenGL driver that render in this process, as one line of text."""
    return f"torch cpu, {torch.get_num_threads()} threads, shading {compiled.backend()}; {gl_backend()}"


class Provenance(BaseModel):
    """What is needed to make the figures of a report again. Seeds are in the code."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    command: str
    versions: dict[str, str]
    backend: str
    when: str = Field(description="UTC, when the measurement ended")
    load: str = Field(description="load of the machine when the measurement ended")

    @classmethod
    def now(cls, command: str) -> "Provenance":
        """The provenance of figures that this process has made just now."""
        load = f"{os.getloadavg()[2]:.1f} processes in the last 15 minutes, {os.cpu_count()} processors"
        when = datetime.now(UTC).isoformat(timespec="seconds")
        return cls(command=command, versions=versions(*PACKAGES), backend=backend(), when=when, load=load)

    def words(self) -> str:
        """The provenance as part of a sentence."""
        packages = ", ".join(f"{name} {number}" for name, number in self.versions.items())
        return f"`{self.command}`, {self.when}; load: {self.load}; {self.backend}; {packages}"
