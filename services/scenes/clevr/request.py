"""CLEVR scenes in requests: one that is to be generated, and the checks of one that somebody wrote."""

from math import hypot
from typing import Annotated

from pydantic import Field, ValidationError

from services.errors import InvalidRequest
from services.scenes.clevr.description import describe, rig_of
from services.scenes.clevr.generator import MAX_OBJECTS, generate
from services.scenes.clevr.placement import check, placed_in
from services.scenes.clevr.records import SceneRecord
from services.scenes.clevr.relations import RELATIONS, directions, relationships
from services.scenes.clevr.rig import Rig
from services.scenes.description import Model, Scene

LEAST_ASIDE = 1e-6
"""Least distance of a camera from the vertical through the origin: from there nothing is left or right."""
DIRECTION = 1e-3
"""Largest difference of a component of a stated direction from the camera's. Official files are off by up to 1e-4."""
_FIELDS = {"Camera": "camera.position", "PointLight": "lights", "SceneObject": "objects"}
"""The parts of a description, and the fields of a record that they follow from."""


class Generate(Model):
    """A scene after CLEVR for the generator to make."""

    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = Field(0, description="seed of the generator")
    index: Annotated[int, Field(ge=0, le=2**63 - 1)] = Field(0, description="number of the scene among those of a seed")
    objects: Annotated[int, Field(ge=1, le=MAX_OBJECTS)] = Field(5, description="number of objects")

    def record(self) -> SceneRecord:
        """Returns the scene. Raises InvalidRequest("generate.objects") if so many objects do not fit."""
        try:
            return generate(self.seed, self.index, objects=(self.objects, self.objects))
        except InvalidRequest as error:
            raise InvalidRequest(f"generate.{error.field}", error.detail) from error


def scene_of(record: SceneRecord) -> Scene:
    """Returns the description of a scene that a request gives as a record.

    Raises InvalidRequest, which names the field, for objects that float, overlap or leave the frame
    ("record.objects.2"), for directions that are not those of the camera ("record.directions.left"), for relations that
    are not those of the objects' places ("record.relationships.left.0"), and for a camera or lights that a scene cannot
    have ("record.camera.position") or that are given without the other ("record.lights").
    """
    if not 0 < len(record.objects) <= MAX_OBJECTS:
        raise InvalidRequest("record.objects", f"there are {len(record.objects)}; a scene has 1 to {MAX_OBJECTS}")
    if missing := [name for name in RELATIONS if name not in record.directions]:
        raise InvalidRequest("record.directions", f"it has no direction of {missing[0]}")
    for given, absent in (("camera", "lights"), ("lights", "camera")):
        if getattr(record, given) is not None and getattr(record, absent) is None:
            raise InvalidRequest(f"record.{absent}", f"is required where `{given}` is given; or leave out both")
    rig = rig_of(record)
    if hypot(*rig.camera[:2]) < LEAST_ASIDE:
        raise InvalidRequest("record.camera.position", "it is straight above or below the origin, which it looks at")
    try:
        check(placed_in(record), rig)
    except InvalidRequest as error:
        raise InvalidRequest(f"record.{error.field}", error.detail) from error
    try:
        scene = describe(record)
    except ValidationError as error:
        raise InvalidRequest(f"record.{_FIELDS[error.title]}", error.errors()[0]["msg"]) from error
    _check_directions(record, rig)
    found = relationships([one.coords_3d for one in record.objects], dict(record.directions.items()))
    for name in RELATIONS:
        for k, (stated, true) in enumerate(zip(record.relationships[name], found[name], strict=True)):
            if sorted(stated) != true:
                said = f"{sorted(stated)}" if len(stated) <= MAX_OBJECTS else f"{len(stated)} objects"
                raise InvalidRequest(
                    f"record.relationships.{name}.{k}",
                    f"it has {said}; by their places the objects {name} of object {k} are {true}",
                )
    return scene


def _check_directions(record: SceneRecord, rig: Rig) -> None:
    """Refuses directions that the image does not show: the truth about left and right would be another's."""
    due = directions(rig)
    for name in RELATIONS:
        stated = record.directions[name]
        if any(abs(a - b) > DIRECTION for a, b in zip(stated, due[name], strict=True)):
            by = "the camera's place" if record.camera is not None else "the direction of `behind`"
            said, true = ([round(x, 4) for x in one] for one in (stated, due[name]))
            raise InvalidRequest(f"record.directions.{name}", f"it is {said}; by {by} it is {true}")
