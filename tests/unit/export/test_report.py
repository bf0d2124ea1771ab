"""The report, parsed as a browser would, and what it calls the files."""

from html.parser import HTMLParser

import pytest

from scene_attack.export.parameters import ParameterTable
from scene_attack.export.report import content, curves, report
from scene_attack.runs.result import Result, subset_image
from tests.unit.api.dashboard_records import result, row

HOSTILE = "<script>alert(1)</script>\"'&"
NO_PARAMETERS = ParameterTable(renderer="torch", parameters=[], large=[])


class Elements(HTMLParser):
    """All start tags with their attributes."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))


def test_the_report_has_its_images_in_it_and_asks_for_nothing_else() -> None:
    files = {"original.png": lambda: b"one", "attacked.png": lambda: b"two"}
    page = Elements(report(Result.model_validate(result()), "vase", NO_PARAMETERS, files, "0f3c"))
    images = [attributes for tag, attributes in page.found if tag == "img"]
    assert [one["src"] for one in images] == ["data:image/png;base64,b25l", "data:image/png;base64,dHdv"]
    assert [one["alt"] for one in images] == ["Original", "Attacked"]
    assert not [tag for tag, attributes in page.found if tag in ("script", "link", "iframe") or "href" in attributes]


def test_the_finding_is_said_in_words_with_the_range_for_which_it_holds() -> None:
    given = result()
    given["change"]["things"] = [{"group": "bump", "subject": "surface of <vase>", "sentence": "dented", "values": []}]
    held = {"variations": 9, "right": 8, "fooled": 6, "share": 0.75, "interval": [0.4, 0.9]}
    given["expectation"] = held | {"wrong_share": 1 / 9, "wrong_interval": [0.0, 0.4]}
    text = report(Result.model_validate(given), "vase", NO_PARAMETERS, {}, None)
    assert "<li>surface of &lt;vase&gt;: dented</li>" in text
    assert "<li>over its range it fools 6 of the 8 fresh variations that the network has right</li>" in text


def test_groups_have_the_same_words_in_every_table() -> None:
    text = report(Result.model_validate(result(steps=1)), "vase", NO_PARAMETERS, {}, "0f3c")
    assert text.count('<th scope="row">surface normals</th>') == 2  # a subset and a share
    assert '<th scope="row">normals</th>' not in text
    assert "1 step," in text


def test_words_of_others_are_text() -> None:
    given = result()
    given["attacked"]["label"] = HOSTILE
    text = report(Result.model_validate(given), HOSTILE, NO_PARAMETERS, {}, HOSTILE)
    assert HOSTILE not in text
    assert "script" not in {tag for tag, _ in Elements(text).found}


def test_a_curve_begins_left_and_its_highest_value_is_on_top() -> None:
    trace = Result.model_validate(result(trace=[row(0, loss=0.5), row(1, loss=0.9), row(4, loss=0.1)])).trace
    loss = curves(trace)[0]
    points = [tuple(float(x) for x in point.split(",")) for point in loss.points.split()]
    assert points == [(0, pytest.approx(80)), (105, 0), (420, 160)]
    assert (loss.first, loss.last, loss.lowest, loss.highest) == (0.5, 0.1, 0.1, 0.9)
    assert curves(trace[:1]) == []


@pytest.mark.questions
def test_each_image_is_called_what_it_is() -> None:
    assert "only some of the changed groups" in content(subset_image(12))
    assert "normal" in content("normals-tilt.png")
    assert "dents" in content("dents.png")
    assert "environment map as it was" in content("map-before.png")
    assert "under attack" in content("map-after.png")
    assert "brighter" in content("map-ratio.png")
    for name in ("attention-0-03-before.png", "attention-0-03-after.png", "attention.safetensors"):
        assert "a file of the job" not in content(name)
    attending = [name for name in ("original.png", "map-ratio.png", subset_image(1)) if "attends" in content(name)]
    assert attending == []
