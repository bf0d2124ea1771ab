"""The command `scene show`: the nodes of a file, what is not shown of it, and its picture."""

import json
from pathlib import Path

import numpy as np
from PIL import Image

from tests.unit.client.command_line import cli
from tests.unit.scenes.scene_files import Room


def test_it_lists_the_nodes_with_sizes_cameras_and_lights(tmp_path: Path) -> None:
    (tmp_path / "room.glb").write_bytes(Room().glb)
    done = cli("scene", "show", str(tmp_path / "room.glb"), SCENE_ATTACK_DATA=str(tmp_path))
    cells = [[cell.strip() for cell in line.split("│")[1:-1]] for line in done.stdout.splitlines() if "│" in line]
    assert [row[:4] for row in cells] == [
        ["0", "Floor", "mesh", "10 × 0 × 10"],
        ["1", "Ball", "mesh", "1 × 1 × 1"],
        ["2", "Table", "", "1 × 3 × 1"],
        ["3", "Lamp", "mesh", "1 × 3 × 1"],
        ["4", "Camera", "camera, 45.8° high", ""],
        ["5", "Bulb", "point light, 800 cd", ""],
        ["6", "Sun", "directional light, 3 lx", ""],
    ]
    assert "  Lamp" in done.stdout


def test_what_is_not_shown_is_said_and_json_has_all(tmp_path: Path) -> None:
    room = Room()
    room.light({"type": "point", "color": [1, 0, 0]}, name="Red", translation=[0, 3, 0])
    (tmp_path / "room.glb").write_bytes(room.glb)
    done = cli("scene", "show", str(tmp_path / "room.glb"), SCENE_ATTACK_DATA=str(tmp_path))
    assert done.stderr.splitlines() == ["not shown: the colour of the lights 'Red': lights are white here"]
    shown = json.loads(
        cli("scene", "show", str(tmp_path / "room.glb"), "--json", SCENE_ATTACK_DATA=str(tmp_path)).stdout
    )
    assert shown["missing"] == ["the colour of the lights 'Red': lights are white here"]
    assert [node["name"] for node in shown["nodes"]][:2] == ["Floor", "Ball"]
    assert shown["lights"][2]["intensity"] == 0.2126


def test_the_picture_shows_the_red_balls_and_the_background_above_them(tmp_path: Path) -> None:
    (tmp_path / "room.glb").write_bytes(Room().glb)
    out = tmp_path / "scene.png"
    done = cli("scene", "show", str(tmp_path / "room.glb"), "--out", str(out), SCENE_ATTACK_DATA=str(tmp_path))
    assert done.returncode == 0, done.stderr
    image = np.asarray(Image.open(out)).astype(int)
    assert image.shape == (224, 336, 3)
    red = image[..., 0] > image[..., 1] + 40
    assert 0.005 < red.mean() < 0.1
    assert (image[0, :20] == 128).all()


def test_a_file_that_is_not_there_or_holds_no_scene_is_named(tmp_path: Path) -> None:
    (tmp_path / "chair.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    for name, sentence in (
        ("none.glb", "bad input: FILE: there is no file"),
        ("chair.obj", "bad input: file: a obj file holds no scene"),
    ):
        done = cli("scene", "show", str(tmp_path / name), SCENE_ATTACK_DATA=str(tmp_path))
        assert done.returncode == 2
        assert sentence in done.stderr
