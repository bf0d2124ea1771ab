"""A job that re-renders an image: its request and its result. This module does not import torch."""

from pydantic import BaseModel, Field

from services.analysis.records import Rerendering
from services.analysis.requests import RerenderingRequest
from services.pipeline.spec import JobSpec, TargetChoice
from services.scenes.description import Model, Scene

IMAGE = "image"
"""Name of the job's file that is the image as it was sent: PNG, JPEG or WebP."""
RENDERING = "rendering.png"
"""Name of the file of the fitted scene's rendering, once the job succeeded."""


class RerenderingSpec(Model):
    """The request of a job that fits a scene to an image, and asks a network about the fitted scene's rendering."""

    image: str = Field(description="SHA-256 of the image's file, which is the job's file `image`")
    scene: Scene
    target: TargetChoice
    fit: RerenderingRequest

    def attack(self) -> JobSpec:
        """An attack on the same scene and network: both can be used if it can run."""
        return JobSpec(scene=self.scene, target=self.target)


class RerenderingView(BaseModel):
    """The network's answers to the image and to the rendering of the scene fitted to it."""

    rerendering: Rerendering
    png: str = Field(description="the rendering as a PNG file in base64")
