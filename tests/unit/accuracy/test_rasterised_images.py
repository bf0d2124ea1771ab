"""The comparison of 5,000 images in short: one scene of one or two objects, and one of three or more."""

from services.accuracy.rasterised_images import beyond, compare, scenes
from services.scenes.library import Library
from services.settings import settings


def test_no_image_is_off_by_more_than_its_plan_says() -> None:
    library = Library(settings().cache_dir, settings().data_dir)
    rows = [compare(scene, library, 1) for scene in scenes(2)]
    assert [len(row["meshes"]) >= 3 for row in rows] == [False, True]
    assert all(row["rasterised"] and row["images"] > 40 for row in rows)
    assert beyond(rows) == []
    assert beyond([rows[0] | {"mean": 2 * rows[0]["plan_mean"]}]) != []
    assert max(row["gradients"] for row in rows) < 0.1
