"""The plan of a job as `scene-attack plan` prints it: that of its images, and the questions it asks."""

import operator

from pydantic import Field

from services.pipeline.question_record import Asked
from services.rendering.plan import Plan


class JobPlan(Plan):
    """The renderer's plan of a job, with what limits its search, and its questions."""

    questions: tuple[Asked, ...] = Field(
        (), exclude_if=operator.not_, description="the questions about the image, with their programs"
    )
