"""The table of files in the README of an export."""

from services.export.report import content
from services.pipeline.question_record import ATTENTION
from services.pipeline.result import subset_image


def test_each_image_is_called_what_it_is() -> None:
    assert "only some of the changed groups" in content(subset_image(12))
    assert "normal" in content("normals-tilt.png")
    assert "environment map as it was" in content("map-before.png")
    assert "under attack" in content("map-after.png")
    assert "brighter" in content("map-ratio.png")
    for name in ("attention-0-03-before.png", "attention-0-03-after.png", ATTENTION):
        assert "a file of the job" not in content(name)
    attending = [name for name in ("original.png", "map-ratio.png", subset_image(1)) if "attends" in content(name)]
    assert attending == []
