"""Generates CLEVR-style scenes from a seed."""

from collections.abc import Sequence
from random import Random

from services.errors import InvalidRequest
from services.scenes.clevr.layout import Placed, place
from services.scenes.clevr.records import CameraRecord, LightsRecord, ObjectRecord, SceneRecord
from services.scenes.clevr.relations import directions, relationships
from services.scenes.clevr.rig import Rig, Viewpoint, jittered
from services.scenes.clevr.visibility import visible_pixels

MIN_OBJECTS, MAX_OBJECTS = 3, 10
MIN_PIXELS = 200
"""Smallest number of pixels, of 240×320, in which each object must be seen."""

DISCARDS = 1000
"""Scenes discarded for a hidden object before `generate` gives up."""


def generate(
    seed: int,
    index: int,
    *,
    objects: tuple[int, int] = (MIN_OBJECTS, MAX_OBJECTS),
    split: str = "new",
) -> SceneRecord:
    """Returns the scene of that index: it depends on the arguments alone, not on the scenes before it.

    The number of objects is uniform within `objects`, both bounds included. A scene in which an object is seen in fewer
    than MIN_PIXELS pixels is discarded, and the objects are placed anew under the same camera and lights. Raises
    InvalidRequest("objects") if so many do not fit.
    """
    random = Random(f"clevr/{seed}/{split}/{index}")
    count = random.randint(*objects)
    rig = jittered(random)
    for _ in range(DISCARDS):
        placed = place(count, rig, random)
        if min(visible_pixels(placed, rig)) >= MIN_PIXELS:
            return record_of(placed, rig, split, index)
    raise InvalidRequest("objects", f"{count} objects cannot all be seen in {MIN_PIXELS} pixels each")


def record_of(placed: Sequence[Placed], rig: Rig, split: str = "new", index: int = 0) -> SceneRecord:
    """Returns the record of placed objects under a camera and lights, with the directions and relations they have."""
    viewpoint, along = Viewpoint(rig), directions(rig)
    return SceneRecord.model_validate(
        {
            "split": split,
            "image_index": index,
            "image_filename": f"CLEVR_{split}_{index:06d}.png",
            "objects": [
                ObjectRecord.model_validate(
                    {
                        "shape": one.shape,
                        "size": one.size,
                        "material": one.material,
                        "color": one.color,
                        "coords_3d": one.centre,
                        "rotation": one.rotation,
                        "pixel_coords": viewpoint.pixel(one.centre),
                    }
                )
                for one in placed
            ],
            "relationships": relationships([one.centre for one in placed], along),
            "directions": along,
            "camera": CameraRecord(position=rig.camera),
            "lights": LightsRecord(key=rig.key, fill=rig.fill, back=rig.back),
        }
    )
