import json

from typer.testing import CliRunner

from scene_attack.cli.app import app


def test_maps_are_listed_with_their_creators_and_licences() -> None:
    listed = json.loads(CliRunner().invoke(app, ["assets", "environments", "--json"]).stdout)
    (uniform,) = [one for one in listed if one["name"] == "uniform"]
    assert uniform["kind"] == "environment"
    shown = CliRunner().invoke(app, ["assets", "environments"]).stdout
    for one in listed:
        (line,) = [line for line in shown.splitlines() if f" {one['name']} " in line]
        assert one["creator"] in line
        assert one["licence"] in line
