"""Files of Blender and USD as glTF: what is in them, what is said to be missing, and what a hostile one cannot do."""

import json
import re
import shlex
import shutil
import subprocess
import sys
from collections import Counter
from contextlib import chdir
from math import atan, pi, sqrt
from pathlib import Path

import numpy as np
import pytest
import trimesh

from scene_attack.cli.commands_page import commands, examples
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


def test_the_examples_of_its_help_run(made: tuple[Path, dict[str, Box]], tmp_path: Path) -> None:
    for file, example in (("room.blend", "room.blend"), ("room.usdz", "kitchen.usdz")):
        shutil.copyfile(made[0] / file, tmp_path / example)
    shown = [example for name, command in commands() if name.endswith("convert") for example in examples(command)]
    assert len(shown) == 2
    for example in shown:
        _, *arguments = shlex.split(example)
        with chdir(tmp_path):
            done = cli(*arguments)
        assert done.returncode == 0, f"{example}\n{done.stdout}{done.stderr}"


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
MIXED = """
mixed = data.materials.new("mixed")
tree = mixed.node_tree
mix, output = tree.nodes.new("ShaderNodeMixShader"), tree.nodes["Material Output"]
tree.links.new(tree.nodes["Principled BSDF"].outputs[0], mix.inputs[1])
tree.links.new(mix.outputs[0], output.inputs[0])
cube.data.materials.append(mixed)
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
CHEQUERED = """
chequered = data.materials.new("chequered")
nodes = chequered.node_tree.nodes
pattern = nodes.new("ShaderNodeTexChecker")
chequered.node_tree.links.new(pattern.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
cube.data.materials.append(chequered)
"""
CAMERA = """
camera = data.objects.new("Camera", data.cameras.new("Camera"))
scene.collection.objects.link(camera)
"""
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
        (MIXED, "the surface of the material mixed: it is no Principled BSDF"),
        (WORLD, "the light of the world Sky"),
        (CHEQUERED, "the colour of the material chequered: glTF has colours and pictures, and no patterns"),
        (CAMERA + "camera.data.type = 'ORTHO'\n", "the camera Camera: it is not a perspective one"),
        (CAMERA + "camera.data.shift_x = 0.1\n", "the shift of the camera Camera"),
        (INCHES, "its unit: one is 0.0254 m in the file, and one metre in what is written"),
        ("", ""),
    ],
    ids=["area light", "material", "mixed", "world", "pattern", "orthographic", "shift", "unit", "nothing"],
)
def test_what_gltf_cannot_say_is_said(tmp_path: Path, scene: str, said: str) -> None:
    file, out = written(tmp_path, SOLID + scene), tmp_path / "room.glb"
    done = converted(file, out)
    assert done.returncode == 0
    assert re.findall("not converted: (.*)", done.stderr) == ([said] if said else [])
    as_json = json.loads(cli("convert", str(file), str(out), "--json").stdout)
    assert as_json == {"file": str(out), "missing": [said] if said else []}


AS_RENDERED = """
def cube(name, x):
    new.primitive_cube_add(location=(x, 0, 0))
    bpy.context.object.name = name
    return bpy.context.object
finer = cube("Finer", 0).modifiers.new("finer", "SUBSURF")
finer.subdivision_type, finer.levels, finer.render_levels = "SIMPLE", 0, 2
twice = cube("Twice", 10).modifiers.new("twice", "ARRAY")
twice.show_viewport = False
cube("Hidden in the viewport", 20).hide_viewport = True
cube("Hidden in renders", 30).hide_render = True
excluded = data.collections.new("excluded")
scene.collection.children.link(excluded)
scene.collection.objects.unlink(left := cube("Excluded", 40))
excluded.objects.link(left)
bpy.context.view_layer.layer_collection.children["excluded"].exclude = True
keyed = cube("Keyed", 50)
keyed.shape_key_add()
key = keyed.shape_key_add()
for point in key.data:
    point.co.z += 4
key.value = 0.5
mirrored = cube("Mirrored", 60)
mirrored.scale.x = -1
tilted = cube("Tilted", 70)
tilted.rotation_euler.z, tilted.parent = math.pi / 4, data.objects.new("Stretched", None)
tilted.parent.scale.x = 3
scene.collection.objects.link(tilted.parent)
bpy.ops.object.armature_add(location=(80, 0, 0))
bones = bpy.context.object
bones.pose.bones[0].location = (0, 5, 0)
held = cube("Held", 0)
held.parent, held.parent_type, held.parent_bone = bones, "BONE", bones.pose.bones[0].name
"""
"""Cubes of side 2; beside each what a picture of it shows."""
INSTANCES = """
bpy.ops.object.text_add(location=(-10, 0, 0))
bpy.ops.object.metaball_add(location=(-20, 0, 0))
new.primitive_plane_add(size=4, location=(0, 20, 0))
plane = bpy.context.object
new.primitive_cube_add(size=0.2)
bpy.context.object.name, bpy.context.object.parent, plane.instance_type = "Copied", plane, "VERTS"
group = data.collections.new("group")
thing, lamp = data.objects.new("Thing", cube.data), data.objects.new("Lamp", data.lights.new("Lamp", "POINT"))
group.objects.link(thing)
group.objects.link(lamp)
group.objects.link(data.objects.new("Key", data.lights.new("Key", "AREA")))
for k in range(2):
    place = data.objects.new("Place", None)
    place.instance_type, place.instance_collection, place.location = "COLLECTION", group, (10 + 10 * k, 0, 0)
    scene.collection.objects.link(place)
"""


def test_a_scene_is_as_blender_renders_it(tmp_path: Path) -> None:
    assert converted(written(tmp_path, AS_RENDERED), tmp_path / "room.glb").returncode == 0
    nodes = {node.name: node for node in read(tmp_path / "room.glb").nodes}
    expected = {
        "Finer": (192, (0, 0, 0), (2, 2, 2)),
        "Twice": (24, (11, 0, 0), (4, 2, 2)),
        "Hidden in the viewport": (12, (20, 0, 0), (2, 2, 2)),
        "Keyed": (12, (50, 2, 0), (2, 2, 2)),
        "Mirrored": (12, (60, 0, 0), (2, 2, 2)),
        "Tilted": (12, (210, 0, 0), (6 * sqrt(2), 2, 2 * sqrt(2))),
        "Held": (12, (80, 6, 0), (2, 2, 2)),
        "Stretched": (0, (210, 0, 0), (6 * sqrt(2), 2, 2 * sqrt(2))),
    }
    assert nodes.keys() == expected.keys() | {"Armature"}
    for name, (triangles, centre, size) in expected.items():
        extent = nodes[name].extent
        assert extent is not None
        assert nodes[name].triangles == triangles, name
        assert extent.centre == pytest.approx(centre, abs=1e-4), name
        assert extent.size == pytest.approx(size, abs=1e-4), name
    cubes = trimesh.load_scene(tmp_path / "room.glb").geometry.values()
    assert sorted(round(cube.volume) for cube in cubes) == [8, 8, 8, 8, 8, 16, 24]  # seen from outside, anticlockwise


def test_what_is_drawn_several_times_is_there_as_often(tmp_path: Path) -> None:
    done = converted(written(tmp_path, SOLID + INSTANCES), tmp_path / "room.glb")
    assert done.returncode == 0
    scene = read(tmp_path / "room.glb")
    nodes = scene.nodes
    above = {node.name: None if node.parent is None else nodes[node.parent].name for node in nodes if node.triangles}
    copies = {f"Copied{number}": "Plane" for number in ("", ".001", ".002", ".003")}
    things = {"Thing": "Place", "Thing.001": "Place.001"}
    assert above == dict.fromkeys(("Cube", "Text", "Mball", "Plane")) | copies | things
    places = {node.name: node.extent.centre for node in nodes if node.extent is not None}
    assert places["Thing"] == pytest.approx((10, 0, 0), abs=1e-5)
    assert places["Thing.001"] == pytest.approx((20, 0, 0), abs=1e-5)
    corners = sorted((round(x), round(z)) for x, _, z in (places[name] for name in copies))
    assert corners == [(-2, -22), (-2, -18), (2, -22), (2, -18)]
    assert sorted(light.position[0] for light in scene.lights) == pytest.approx([10, 20])
    assert re.findall("not converted: (.*)", done.stderr) == [
        f"the area light {name}: glTF has point, directional and spot lights" for name in ("Key", "Key.001")
    ]


HIDDEN = """
def cube(name, x):
    new.primitive_cube_add(size=1, location=(x, 0, 0.5))
    bpy.context.object.name = name
    return bpy.context.object
def into(collection, thing):
    for one in thing.users_collection:
        one.objects.unlink(thing)
    collection.objects.link(thing)
def collection(name, under=scene.collection):
    made = data.collections.new(name)
    under.children.link(made)
    return made
layers = bpy.context.view_layer.layer_collection.children
cube("Screen", 1).hide_viewport = True
cube("Eye", 2).hide_set(True)
into(collection("Off"), cube("ScreenOfCollection", 3))
data.collections["Off"].hide_viewport = True
outer = collection("Outer")
outer.hide_render = True
into(collection("Inner", outer), cube("NotRenderedBelow", 4))
cube("NotRendered", 5).hide_render = True
cube("NotSeen", 6).visible_camera = False
library = collection("Library")
into(library, cube("Part", 0))
unrendered = cube("UnrenderedPart", 0)
into(library, unrendered)
unrendered.hide_render = True
layers["Library"].exclude = True
stand = data.objects.new("Stand", None)
stand.instance_type, stand.instance_collection, stand.location = "COLLECTION", library, (7, 0, 0)
scene.collection.objects.link(stand)
"""


def test_what_blender_renders_is_there_and_nothing_else(tmp_path: Path) -> None:
    """Also what viewports hide, in its place, and what stands in a collection that only an instance shows."""
    done = converted(written(tmp_path, HIDDEN), tmp_path / "room.glb")
    assert done.returncode == 0, done.stderr
    places = {
        node.name: node.extent.centre[0] for node in read(tmp_path / "room.glb").nodes if node.triangles and node.extent
    }
    assert places == pytest.approx({"Screen": 1, "Eye": 2, "ScreenOfCollection": 3, "Part": 7}, abs=1e-4)


MANY = """
bpy.ops.object.text_add()
bpy.context.object.name, bpy.context.object.data.body = "Text", "A"
bpy.ops.curve.primitive_bezier_circle_add()
bpy.context.object.name, bpy.context.object.data.bevel_depth = "Ring", 0.1
bpy.ops.object.metaball_add(type="BALL")
new.primitive_plane_add(size=4)
grid = bpy.context.object
grid.name, grid.instance_type = "Grid", "VERTS"
new.primitive_cube_add(size=0.3)
bpy.context.object.name, bpy.context.object.parent = "Bead", grid
new.primitive_plane_add(size=1)
scattered = bpy.context.object
scattered.name = "Scattered"
group = data.node_groups.new("scatter", "GeometryNodeTree")
for side in ("INPUT", "OUTPUT"):
    group.interface.new_socket("Geometry", in_out=side, socket_type="NodeSocketGeometry")
start, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
cube, instances = group.nodes.new("GeometryNodeMeshCube"), group.nodes.new("GeometryNodeInstanceOnPoints")
group.links.new(start.outputs[0], instances.inputs["Points"])
group.links.new(cube.outputs[0], instances.inputs["Instance"])
group.links.new(instances.outputs[0], end.inputs[0])
scattered.modifiers.new("scatter", "NODES").node_group = group
"""


def test_each_thing_is_there_once(tmp_path: Path) -> None:
    done = converted(written(tmp_path, MANY), tmp_path / "room.glb")
    assert done.returncode == 0, done.stderr
    nodes = read(tmp_path / "room.glb").nodes
    of = Counter(nodes[node.parent].name if node.parent is not None else node.name for node in nodes if node.triangles)
    assert of == {"Text": 1, "Ring": 1, "Mball": 1, "Grid": 1 + 4, "Scattered": 4}


def test_a_material_of_the_object_takes_the_place_of_the_meshs(tmp_path: Path) -> None:
    materials = """
for name, color in (("Of the mesh", (1, 0, 0, 1)), ("Of the object", (0, 0, 1, 1))):
    made = data.materials.new(name)
    made.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = color
cube.data.materials.append(data.materials["Of the mesh"])
cube.material_slots[0].link, cube.material_slots[0].material = "OBJECT", data.materials["Of the object"]
"""
    assert converted(written(tmp_path, SOLID + materials), tmp_path / "room.glb").returncode == 0
    [mesh] = trimesh.load_scene(tmp_path / "room.glb").geometry.values()
    assert mesh.visual.material.name == "Of the object"


def test_the_active_camera_is_the_first(tmp_path: Path) -> None:
    """Also one that hangs on something, and is in a collection."""
    cameras = """
for name in ("First", "Active"):
    scene.collection.objects.link(data.objects.new(name, data.cameras.new(name)))
scene.camera = data.objects["Active"]
shelf = data.collections.new("Shelf")
scene.collection.children.link(shelf)
arm = data.objects.new("Arm", None)
for thing in (arm, scene.camera):
    shelf.objects.link(thing)
scene.collection.objects.unlink(scene.camera)
scene.camera.parent = arm
"""
    done = converted(written(tmp_path, SOLID + cameras), tmp_path / "room.glb")
    assert done.returncode == 0, done.stderr
    assert [camera.name for camera in read(tmp_path / "room.glb").cameras] == ["Active", "First"]


def test_the_nodes_of_lights_count_as_far_as_they_are_a_strength(tmp_path: Path) -> None:
    lamps = """
for kind in ("POINT", "SUN", "SPOT"):
    light = data.lights.new(kind, kind)
    light.energy, light.use_nodes = 10.0, True
    light.node_tree.nodes["Emission"].inputs["Strength"].default_value = 3.0
    scene.collection.objects.link(data.objects.new(kind, light))
tree = data.lights["SPOT"].node_tree
tree.links.new(tree.nodes.new("ShaderNodeLightFalloff").outputs[0], tree.nodes["Emission"].inputs["Strength"])
"""
    done = converted(written(tmp_path, SOLID + lamps), tmp_path / "room.glb")
    assert re.findall("not converted: (.*)", done.stderr) == ["the nodes of the light SPOT"]
    lights = {light.kind: light.intensity / LUMENS for light in read(tmp_path / "room.glb").lights}
    expected = {"point": 30 / (4 * pi), "directional": 30, "spot": 10 / (4 * pi)}
    assert lights == pytest.approx(expected, rel=1e-3)


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


TEXTURED = """#usda 1.0
(
    subLayers = [@../other.usda@]
)
def Camera "flat"
{
    float verticalAperture = 1
}
def Mesh "triangle" (
    prepend apiSchemas = ["MaterialBindingAPI"]
)
{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    rel material:binding = </wooden>
}
def Material "wooden"
{
    token outputs:surface.connect = </wooden/surface.outputs:surface>
    def Shader "surface"
    {
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor.connect = </wooden/picture.outputs:rgb>
        token outputs:surface
    }
    def Shader "picture"
    {
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @./wood.png@
        float3 outputs:rgb
    }
}
"""


def test_what_a_usd_file_is_made_of_and_is_not_there_is_said(tmp_path: Path) -> None:
    file = tmp_path / "mine" / "room.usda"
    file.parent.mkdir()
    file.write_text(TEXTURED)
    done = converted(file, tmp_path / "room.glb")
    assert done.returncode == 0, done.stderr
    assert re.findall("not converted: (.*)", done.stderr) == [
        f"the layer {tmp_path}/other.usda: it is not there, or outside the folder of the file",
        "an image of the material wooden: it is not there, or outside the folder of the file",
    ]


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


NEGATIVE = b"""#usda 1.0
def Mesh "mesh"
{
    int[] faceVertexCounts = [-3, 1000000]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
}
"""


def test_a_file_that_is_none_is_one_sentence(tmp_path: Path) -> None:
    whole = written(tmp_path, SOLID).read_bytes()
    for name, content, why in (
        ("cut.blend", whole[: len(whole) // 2], "Blender cannot read cut.blend: "),
        ("text.blend", b"hello", "Blender cannot read text.blend: "),
        ("text.usda", b"hello", "Blender cannot read text.usda: "),
        ("wrong.usda", NEGATIVE, "Blender was ended by the signal SIG[A-Z]*, while it read wrong.usda"),
        ("cut.usdz", b"PK\x03\x04", "Blender cannot read cut.usdz: "),
        ("empty.usda", b"#usda 1.0\n", "Blender cannot read empty.usda: it holds no mesh that Blender would render"),
        ("room.fbx", b"", "room.fbx ends in none of .blend, .usd, .usda, .usdc, .usdz"),
    ):
        (tmp_path / name).write_bytes(content)
        done = converted(tmp_path / name, tmp_path / "out.glb")
        assert done.returncode == 2
        assert re.match(f"scene-attack: bad input: FILE: {why}", done.stderr)
        assert done.stderr.count("\n") == 1
        assert not (tmp_path / "out.glb").exists()


@pytest.mark.parametrize(
    ("file", "out", "why"),
    [
        ("none.blend", "out.glb", "FILE: there is no file none.blend"),
        ("room.blend", "out.gltf", "OUT: out.gltf does not end in .glb"),
        ("room.blend", "folder.glb", "OUT: folder.glb is a folder"),
        ("room.blend", "no/out.glb", "OUT: there is no folder no"),
    ],
)
def test_bad_arguments_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str, out: str, why: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("room.blend").touch()
    Path("folder.glb").mkdir()
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
