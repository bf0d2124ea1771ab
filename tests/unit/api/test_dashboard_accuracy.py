"""The page about accuracy shows the committed measurements, all of them and nothing else."""

from html.parser import HTMLParser
from typing import Any

from httpx import Client

from api.dashboard.accuracy import results, scene_of
from api.dashboard.words import small
from tests.unit.api.test_dashboard_pages import Tags


class Tables(HTMLParser):
    """The number of rows in the body of each table."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.rows: list[int] = []
        self.is_body = False
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        if tag == "table":
            self.rows.append(0)
        self.is_body = tag == "tbody" or (self.is_body and tag != "thead")
        self.rows[-1:] = [self.rows[-1] + 1] if tag == "tr" and self.is_body else self.rows[-1:]


def found(name: str) -> dict[str, Any]:
    measured = results(name)
    assert measured is not None
    return measured


def test_every_row_of_a_choice_is_in_the_plot_and_in_its_table(client: Client) -> None:
    rows = [row for row in found("work-precision")["shading"] if scene_of(row) == "furniture/grand-piano, map 16×32"]
    rows = [row for row in rows if row["groups"] == ["normals"]]
    assert rows
    asked = {"scene": "furniture/grand-piano, map 16×32", "groups": "normals", "error": "rms", "family": "lobes"}
    html = client.get("/accuracy", params=asked).text
    lobes = [row for row in found("stability")["cases"] if row["family"] == "lobes"]
    success, shading, _, cases, _ = Tables(html).rows
    assert (success, shading, cases) == (len(found("work-precision")["success"]), len(rows), len(lobes))
    for row in rows:
        assert small(row["rms"]) in html
        assert f"{row['both']['median']:.3g}" in html
    drawn = html.partition('data-plot="shading"')[2].partition("</figure>")[0].count("<title>")
    assert drawn == sum(row["rms"] > 0 for row in rows)


def test_a_choice_that_there_is_not_is_the_first_one(client: Client) -> None:
    asked = {"scene": "x", "groups": "y", "error": "z", "parameter": "a", "family": ""}
    page = client.get("/accuracy", params=asked)
    assert page.status_code == 200
    assert "torch normals" in Tags(page.text).text


def test_an_installation_without_the_measurements_says_so(client: Client, monkeypatch: Any) -> None:
    monkeypatch.setattr("api.dashboard.accuracy.results", lambda _: None)
    assert "lacks the folder" in Tags(client.get("/accuracy").text).text
