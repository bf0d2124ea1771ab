"""Declares renderers that draw the pyrender renderer's scene by tracing paths of light: its groups, and their settings.

It imports no torch. What such a renderer derives from is `path_tracer.PathTracer`.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Annotated

from pydantic import Field

from scene_attack.rendering.declaration import Declaration
from scene_attack.rendering.pyrender.declaration import PYRENDER
from scene_attack.strict import Model

Samples = Annotated[int, Field(ge=1, le=65_536)]
LARGEST_SEED = 2**30
"""Seeds of exact images and of other verdicts follow it, and all of them are integers of 32 bits."""


class PathTracing(Model):
    """How paths are traced. Images inside the attack all have the same random numbers, so that differences of images
    have little of their noise.
    """

    samples: Samples = Field(default=16, description="paths of each pixel of an image inside the attack")
    verify_samples: Samples = Field(
        default=128, description="paths of each pixel of an exact image, on which verdicts are"
    )
    bounces: Annotated[int, Field(ge=0, le=64)] = Field(
        default=4,
        description="times that light goes on from a surface to another one; 0: surfaces are lit by lights and the sky",
    )
    seed: Annotated[int, Field(ge=0, le=LARGEST_SEED)] = Field(
        default=0, description="seed of the paths inside the attack; exact images have others, which follow it"
    )


def path_traced(name: str, explanation: str, renderer: str, requires: Callable[[str], None]) -> Declaration:
    """Declares a renderer with the groups of pyrender, and that groups' words, ranges and attacks.

    For `renderer` and `requires` see `Declaration`.
    """
    return replace(
        PYRENDER, name=name, explanation=explanation, renderer=renderer, requires=requires, settings=PathTracing
    )
