"""A scene as CLEVR describes it, `scene.source` of the format "clevr": a record of its files, or what to make one of.

This module does not import torch.
"""

import json
from math import isclose
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from scene_attack.errors import InvalidRequest, below
from scene_attack.scenes.description import Camera, Scene, SceneObject
from scene_attack.scenes.source import Source, register_source
from scene_attack.strict import Model, absent
from scene_attack_questions.clevr.description import record_after, scene_of
from scene_attack_questions.clevr.generator import MAX_OBJECTS, generate
from scene_attack_questions.clevr.records import IMAGE_SIZE, SceneRecord
from scene_attack_questions.executor import Facts

FIELD = "scene.source"
PROPORTION = 0.01
"""Largest relative difference of an image's proportions from those of CLEVR's."""
ROUNDING = 1e-6
"""Largest difference between a scene and the one that follows from its record, for a record that was described on
another machine, whose trigonometric functions round differently."""


class Generate(Model):
    """A scene after CLEVR for the generator to make."""

    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = Field(0, description="seed of the generator")
    index: Annotated[int, Field(ge=0, le=2**63 - 1)] = Field(0, description="number of the scene among those of a seed")
    objects: Annotated[int, Field(ge=1, le=MAX_OBJECTS)] = Field(5, description="number of objects")

    def record(self) -> SceneRecord:
        """Returns the scene. Raises InvalidRequest("generate.objects") if so many objects do not fit."""
        with below("generate"):
            return generate(self.seed, self.index, objects=(self.objects, self.objects))


@register_source("clevr")
class Clevr(Source):
    """A scene in CLEVR's own format, from whose objects the right answers follow."""

    slow: ClassVar[str | None] = "generate"

    format: Literal["clevr"]
    record: SceneRecord | None = Field(
        default=None, exclude_if=absent, description="the scene, as it is in CLEVR's files of scenes"
    )
    generate: Generate | None = Field(
        default=None, exclude_if=absent, description="a scene to make, in place of `record`, which is filled in"
    )

    @field_validator("record")
    @classmethod
    def _writable(cls, value: SceneRecord | None) -> SceneRecord | None:
        """Refuses a record that JSON cannot hold: its texts and the fields of others may be anything that was read."""
        try:
            if value is not None:
                json.dumps(value.model_dump(mode="json"), ensure_ascii=False, allow_nan=False).encode()
        except (ValueError, RecursionError) as error:
            detail = "it has a text that is no Unicode, a number that is not finite, or is nested too deep"
            raise ValueError(detail) from error
        return value

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if self.record is None and self.generate is None:
            raise ValueError("record: is required, or `generate` in its place")
        if self.record is not None and self.generate is not None:
            raise ValueError("generate: leave it out where `record` is given")
        return self

    def stated(self) -> SceneRecord:
        """The record. Raises InvalidRequest("generate.objects") if so many objects do not fit."""
        if self.record is not None:
            return self.record
        assert self.generate is not None
        return self.generate.record()

    def filled_in(self) -> Self:
        """With the record of the scene that was to be made."""
        return self if self.generate is None else type(self)(format="clevr", record=self.stated())

    def follows(self) -> dict[str, Any]:
        """The fields of the record's scene. Raises InvalidRequest as `scene_of` does."""
        scene = scene_of(self.stated())
        return {name: getattr(scene, name) for name in scene.model_fields_set}

    def check(self, scene: Scene) -> None:
        """Raises InvalidRequest("scene") unless objects and camera are those of the record, and as `scene_of` does.

        Raises InvalidRequest("scene.camera.size") for an image of other proportions, whose frame would be another.
        """
        _check(scene, self.stated())


def _check(scene: Scene, record: SceneRecord) -> None:
    with below(FIELD):
        due = scene_of(record)
    same = len(scene.objects) == len(due.objects) and all(
        _is_same(thing, other) for thing, other in zip(scene.objects, due.objects, strict=True)
    )
    if scene.fixed or not same or not _is_seen_from(scene.camera, due.camera):
        raise InvalidRequest("scene", "its objects and camera are not those of its source; leave them out")
    rows, columns = scene.camera.size
    if not isclose(rows / columns, IMAGE_SIZE[0] / IMAGE_SIZE[1], rel_tol=PROPORTION):
        raise InvalidRequest(
            "scene.camera.size", f"{rows}×{columns} has not the proportions of CLEVR's images, 3 to 4, as 240×320 has"
        )
    if Facts.of(record_after(record, scene)) != Facts.of(record):
        raise InvalidRequest(f"{FIELD}.record", "its attributes and relations are not those of its objects")


def _is_same(thing: SceneObject, other: SceneObject) -> bool:
    fields = ("mesh", "material", "metallic", "roughness")
    vectors = ("color", "translation", "rotation")
    return (
        all(getattr(thing, name) == getattr(other, name) for name in fields)
        and isclose(thing.scale, other.scale, abs_tol=ROUNDING)
        and all(
            isclose(a, b, abs_tol=ROUNDING)
            for name in vectors
            for a, b in zip(getattr(thing, name), getattr(other, name), strict=True)
        )
    )


def _is_seen_from(camera: Camera, other: Camera) -> bool:
    places = ("azimuth", "elevation", "distance", "roll", "field_of_view")
    return all(isclose(getattr(camera, name), getattr(other, name), abs_tol=ROUNDING) for name in places)
