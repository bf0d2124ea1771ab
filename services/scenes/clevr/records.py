"""CLEVR's scene files: reads and writes them, keeping fields that are not CLEVR's.

The format is that of CLEVR v1.0 (`scenes/CLEVR_val_scenes.json`) and of its generator. Scenes made here have two more
fields, `camera` and `lights`, without which a scene cannot be drawn again as it was; other programs ignore them.
"""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import ConfigDict, FailFast, Field, ValidationError, model_validator

from services import atomic_write
from services.errors import InvalidRequest
from services.scenes.clevr.attributes import ATTRIBUTES
from services.scenes.clevr.relations import RELATIONS, Relation
from services.scenes.clevr.rig import Rig
from services.strict import Strict

Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
Indices = Annotated[tuple[int, ...], FailFast()]
Rows = Annotated[tuple[Indices, ...], FailFast()]


class Record(Strict):
    """Base class of what is in CLEVR's files: strict, frozen; unknown fields are kept and written again."""

    model_config = ConfigDict(extra="allow", frozen=True, validate_by_name=True, validate_by_alias=True)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Reads a file. Raises InvalidRequest, which names the first invalid field ("scenes.3.objects.0.size")."""
        try:
            return cls.model_validate_json(path.read_bytes())
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"]) or "file"
            raise InvalidRequest(where, f"{path.name}: {first['msg']}") from error

    def write(self, path: Path) -> None:
        """Writes a file: the fields that were read or set, under CLEVR's names."""
        atomic_write.write(path, self.model_dump_json(by_alias=True, exclude_unset=True).encode())


class ObjectRecord(Record):
    """An object of a scene.

    `coords_3d` is its centre; `pixel_coords` column, row and distance along the viewing direction; `rotation` its turn
    about +z in degrees.
    """

    shape: Literal["cube", "sphere", "cylinder"]
    size: Literal["small", "large"]
    material: Literal["rubber", "metal"]
    color: Literal["gray", "red", "blue", "green", "brown", "purple", "cyan", "yellow"]
    coords_3d: Vector = Field(alias="3d_coords")
    rotation: Finite
    pixel_coords: tuple[int, int, Finite]

    def value(self, attribute: str) -> str:
        """Returns the value of one of ATTRIBUTES."""
        assert attribute in ATTRIBUTES
        found: str = getattr(self, attribute)
        return found


class CameraRecord(Record):
    """The camera of a scene made here: its position; it looks at the origin."""

    position: Vector


class LightsRecord(Record):
    """The positions of the three point lights of a scene made here."""

    key: Vector
    fill: Vector
    back: Vector


class SceneRecord(Record):
    """A scene. `relationships[r][i]` are the indices of the objects that have relation r to object i."""

    split: str
    image_index: int
    image_filename: str
    objects: Annotated[tuple[ObjectRecord, ...], FailFast()]
    relationships: dict[Relation, Rows]
    directions: dict[Literal["left", "right", "front", "behind", "above", "below"], Vector]
    camera: CameraRecord | None = None
    lights: LightsRecord | None = None

    @model_validator(mode="after")
    def _relations_are_whole(self) -> Self:
        count = len(self.objects)
        for name in RELATIONS:
            rows = self.relationships.get(name, ())
            if len(rows) != count or not all(0 <= other < count for row in rows for other in row):
                raise ValueError(
                    f"relationships.{name}: it must have a list of other objects' indices for each of {count} objects"
                )
        return self

    @property
    def rig(self) -> Rig | None:
        """Camera and lights, if the record has them; official files do not."""
        if self.camera is None or self.lights is None:
            return None
        return Rig(self.camera.position, self.lights.key, self.lights.fill, self.lights.back)


class Info(Record):
    """The header of CLEVR's files."""

    split: str
    version: str = "1.0"
    date: str = ""
    license: str = ""


class SceneFile(Record):
    """A file of scenes."""

    info: Info
    scenes: tuple[SceneRecord, ...]
