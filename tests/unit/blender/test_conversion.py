"""Files of Blender and USD as glTF: what is in them, what is said to be missing, and what a hostile one cannot do."""

import json
import re
import subprocess
import sys
from math import atan, pi
from pathlib import Path

import numpy as np
import pytest

from scene_attack.cli.specs import local_library
from scene_attack.client.meshes import bundle_at
from scene_attack.options import DEFAULTS
from scene_attack.scenes.scene_file import SceneFile
from scene_attack_blender import plugin
from scene_attack_blender.process import environment
from tests.unit.blender.blend_files import Box, room, written
from tests.unit.client.command_line import Done, cli
from tests.unit.path_tracing.conftest import missing

pytestmark = pytest.mark.slow

LUMENS = 683.0
"""Lumens of a watt, by which Blender's exporter makes photometric units of its own."""


@pytest.fixture(scope="module", autouse=True)
def _blender() -> None:
    if why := missing("blender"):
        pytest.skip(why)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Box]]:
    folder = tmp_path_factory.mktemp("room")
    return folder, room(folder)


def read(file: Path) -> SceneFile:
    library = local_library(DEFAULTS)
    return library.scene(library.add(bundle_at(file, DEFAULTS), DEFAULTS).name)


def converted(file: Path, to: Path) -> Done:
    return cli("convert", str(file), str(to))


@pytest.mark.parametrize("name", ["room.blend", "room.usda", "room.usdz"])
def test_a_scene_has_the_sizes_lights_and_camera_that_blender_states(
    made: tuple[Path, dict[str, Box]], tmp_path: Path, name: str
) -> None:
    folder, boxes = made
    done = converted(folder / name, tmp_path / "room.glb")
    assert done.returncode == 0, done.stderr
    scene = read(tmp_path / "room.glb")
    extents = {node.name: node.extent for node in scene.nodes}
    for thing, (low, high) in boxes.items():
        extent = extents[thing]
        assert extent is not None
        if thing == "Monkey":  # the ball is below its node
            low, high = np.minimum(low, boxes["Ball"][0]), np.maximum(high, boxes["Ball"][1])
        (x, y, z), (width, depth, height) = np.add(low, high) / 2, np.subtract(high, low)
        assert extent.centre == pytest.approx((x, z, -y), abs=1e-4)  # +z is up in Blender, +y in glTF
        assert extent.size == pytest.approx((width, height, depth), abs=1e-4)
    [camera] = scene.cameras
    assert camera.position == pytest.approx((4, 3, 5), abs=1e-5)
    assert camera.field_of_view == pytest.approx(2 * atan(18 / 50 * 480 / 640), rel=1e-3)
    lights = {light.kind: light.intensity for light in scene.lights}
    expected = {"point": 100 * LUMENS / (4 * pi), "directional": 2 * LUMENS, "spot": 50 * LUMENS / (4 * pi)}
    assert lights == pytest.approx(expected, rel=1e-3)


SOLID = "new.primitive_cube_add()\ncube = bpy.context.object\n"
AREA = """
lamp = data.objects.new("Key", data.lights.new("Key", "AREA"))
scene.collection.objects.link(lamp)
"""
GLOSSY = """
glossy = data.materials.new("glossy")
nodes = glossy.node_tree.nodes
nodes.clear()
shader = nodes.new("ShaderNodeBsdfGlossy")
glossy.node_tree.links.new(shader.outputs[0], nodes.new("ShaderNodeOutputMaterial").inputs[0])
cube.data.materials.append(glossy)
"""
WORLD = "scene.world = data.worlds.new('Sky')\n"
INCHES = "scene.unit_settings.scale_length = 0.0254\n"
PICTURE = """
picture = data.images.new("wood", 8, 8)
picture.filepath_raw, picture.file_format = {path!r}, "PNG"
picture.save()
picture.source = "FILE"
wooden = data.materials.new("wooden")
texture = wooden.node_tree.nodes.new("ShaderNodeTexImage")
texture.image = picture
inputs = wooden.node_tree.nodes["Principled BSDF"].inputs
wooden.node_tree.links.new(texture.outputs["Color"], inputs["Base Color"])
cube.data.materials.append(wooden)
"""
LINKED = """
with data.libraries.load({path!r}, link=True) as (there, here):
    here.objects = there.objects
for thing in here.objects:
    scene.collection.objects.link(thing)
"""
RUNS = """
text = data.texts.new("start.py")
text.write("open({path!r}, 'w').write('a text ran')")
text.use_module = True
driven = cube.driver_add("location", 0).driver
driven.type, driven.expression = "SCRIPTED", "open({path!r}, 'w').write('a driver ran')"
"""


@pytest.mark.parametrize(
    ("scene", "said"),
    [
        (AREA, "the area light Key: glTF has point, directional and spot lights"),
        (GLOSSY, "the surface of the material glossy: it is no Principled BSDF"),
        (WORLD, "the light of the world Sky"),
        (INCHES, "its unit: one is 0.0254 m in the file, and one metre in what is written"),
        ("", ""),
    ],
    ids=["area light", "material", "world", "unit", "nothing"],
)
def test_what_gltf_cannot_say_is_said(tmp_path: Path, scene: str, said: str) -> None:
    file, out = written(tmp_path, SOLID + scene), tmp_path / "room.glb"
    done = converted(file, out)
    assert done.returncode == 0
    assert re.findall("not converted: (.*)", done.stderr) == ([said] if said else [])
    as_json = json.loads(cli("convert", str(file), str(out), "--json").stdout)
    assert as_json == {"file": str(out), "missing": [said] if said else []}


def test_lights_that_blenders_exporter_fails_at_are_converted(tmp_path: Path) -> None:
    """A lamp whose power is of an area of 4 m², and one whose colour is of a temperature."""
    lamps = """
for kind in ("POINT", "SPOT"):
    light = data.lights.new(kind, kind)
    light.energy, light.use_temperature = 10.0, kind == "POINT"
    light.normalize, light.shadow_soft_size = kind == "POINT", 0.5
    scene.collection.objects.link(data.objects.new(kind, light))
"""
    done = converted(written(tmp_path, SOLID + lamps), tmp_path / "room.glb")
    assert done.returncode == 0, done.stderr
    lights = {light.kind: light.intensity * 4 * pi / LUMENS for light in read(tmp_path / "room.glb").lights}
    assert lights == pytest.approx({"point": 10, "spot": 10 * 4 * pi * 0.5**2}, rel=1e-3)


@pytest.mark.parametrize("where", ["beside", "outside"])
def test_a_picture_is_read_beside_the_file_alone(tmp_path: Path, where: str) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    path = str((folder if where == "beside" else tmp_path) / "wood.png")
    done = converted(written(folder, SOLID + PICTURE.format(path=path)), tmp_path / "room.glb")
    assert done.returncode == 0
    missing = "the image //../wood.png: it is not there, or outside the folder of the file"  # // is the file's folder
    said = [missing] if where == "outside" else []
    assert re.findall("not converted: (.*)", done.stderr) == said
    assert (b"PNG" in (tmp_path / "room.glb").read_bytes()) == (where == "beside")


def test_objects_of_a_file_elsewhere_are_missing_and_said(tmp_path: Path) -> None:
    mine, other = tmp_path / "mine", tmp_path / "other"
    mine.mkdir()
    other.mkdir()
    library = written(other, "new.primitive_monkey_add()\nbpy.context.object.name = 'Monkey'\n")
    done = converted(written(mine, SOLID + LINKED.format(path=str(library))), tmp_path / "room.glb")
    assert done.returncode == 0
    [said] = re.findall("not converted: (.*)", done.stderr)
    assert re.fullmatch(r"what is linked from \S*room.blend: it is not there, or outside the folder of the file", said)
    assert [node.name for node in read(tmp_path / "room.glb").nodes if node.triangles] == ["Cube"]


def test_a_layer_elsewhere_is_missing_and_said(made: tuple[Path, dict[str, Box]], tmp_path: Path) -> None:
    file = tmp_path / "room.usda"
    ball = 'def Sphere "ball"\n{\n    double radius = 0.5\n}\n'
    elsewhere = made[0] / "room.usda"
    file.write_text(f'#usda 1.0\ndef Xform "far" (\n    references = @{elsewhere}@\n)\n{{\n}}\n{ball}')
    done = converted(file, tmp_path / "room.glb")
    assert done.returncode == 0, done.stderr
    said = f"the layer {elsewhere}: it is not there, or outside the folder of the file"
    assert re.findall("not converted: (.*)", done.stderr) == [said]


def test_no_script_of_a_file_is_run(tmp_path: Path) -> None:
    left = tmp_path / "left"
    file = written(tmp_path, SOLID + RUNS.format(path=str(left)))
    left.unlink(missing_ok=True)  # the driver ran in the Blender that made it
    done = converted(file, tmp_path / "room.glb")
    assert done.returncode == 0
    assert re.findall("not converted: (.*)", done.stderr) == [
        "what its scripts and Python drivers would do: none is run"
    ]
    assert not left.exists()


def test_every_thread_of_blender_is_confined(tmp_path: Path) -> None:
    """Geometry nodes, for one, read files in threads that Blender starts when it is imported, and Landlock confines a
    thread and those that it starts later. It needs that a thread gains no privileges, which the kernel shows.
    """
    file, folder = written(tmp_path, SOLID), tmp_path / "temporary"
    folder.mkdir()
    code = (
        "import runpy, sys\n"
        "runpy.run_module('scene_attack_blender.conversion', run_name='__main__')\n"
        "print('converted', flush=True)\n"
        "sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-P", "-c", code, file, folder],
        env=environment(str(folder)),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as blender:
        assert blender.stdout is not None
        assert "converted\n" in blender.stdout
        states = [task.read_text() for task in Path(f"/proc/{blender.pid}/task").glob("*/status")]
        blender.communicate("")
    assert len(states) > 1
    assert all("NoNewPrivs:\t1\n" in state for state in states)


def test_a_file_that_is_none_is_one_sentence(tmp_path: Path) -> None:
    whole = written(tmp_path, SOLID).read_bytes()
    for name, content, why in (
        ("cut.blend", whole[: len(whole) // 2], "Blender cannot read cut.blend: "),
        ("text.blend", b"hello", "Blender cannot read text.blend: "),
        ("text.usda", b"hello", "Blender cannot read text.usda: "),
        ("cut.usdz", b"PK\x03\x04", "Blender cannot read cut.usdz: "),
        ("empty.usda", b"#usda 1.0\n", "Blender cannot read empty.usda: it holds no mesh"),
        ("room.fbx", b"", "room.fbx ends in none of .blend, .usd, .usda, .usdc, .usdz"),
    ):
        (tmp_path / name).write_bytes(content)
        done = converted(tmp_path / name, tmp_path / "out.glb")
        assert done.returncode == 2
        assert done.stderr.startswith(f"scene-attack: bad input: FILE: {why}")
        assert done.stderr.count("\n") == 1
        assert not (tmp_path / "out.glb").exists()


@pytest.mark.parametrize(
    ("file", "out", "why"),
    [
        ("none.blend", "out.glb", "FILE: there is no file none.blend"),
        ("room.blend", "out.gltf", "OUT: out.gltf does not end in .glb"),
        ("room.blend", "no/out.glb", "OUT: there is no folder no"),
    ],
)
def test_bad_arguments_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str, out: str, why: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("room.blend").touch()
    done = cli("convert", file, out)
    assert (done.returncode, done.stderr.startswith(f"scene-attack: bad input: {why}")) == (2, True)


def test_without_blender_the_command_says_what_it_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugin, "version", lambda _: "4.5.1")
    (tmp_path / "room.blend").touch()
    done = converted(tmp_path / "room.blend", tmp_path / "room.glb")
    assert done.returncode == 2
    assert "the conversion needs the package bpy 5.0, which is there as 4.5.1: pip install" in done.stderr


def test_a_mesh_that_must_be_converted_is_refused_with_the_command(tmp_path: Path) -> None:
    done = cli("scene", "show", str(written(tmp_path, SOLID)))
    assert done.returncode == 2
    assert "`scene-attack convert` makes a .glb file of it" in done.stderr
