"""Files of scenes that Blender itself writes, from its own primitives."""

import json
import subprocess
import sys
from pathlib import Path

Box = tuple[list[float], list[float]]
"""Least and largest coordinates, of which z is upwards."""
START = """
import json, math, sys
import bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
scene, data, new = bpy.context.scene, bpy.data, bpy.ops.mesh
"""
ROOM = """
new.primitive_plane_add(size=6)
bpy.context.object.name = "Floor"
new.primitive_monkey_add(location=(0.3, -0.4, 1.2), rotation=(0.1, 0.2, 0.7))
monkey = bpy.context.object
monkey.name, monkey.scale = "Monkey", (0.5, 0.7, 0.6)
finer = monkey.modifiers.new("finer", "SUBSURF")
finer.levels = finer.render_levels = 2  # as Blender reads it from USD
new.primitive_uv_sphere_add(radius=0.25, location=(0.0, 0.0, 1.0))
ball = bpy.context.object
ball.name, ball.parent = "Ball", monkey
picture = data.images.new("squares", 8, 8)
picture.generated_type = "UV_GRID"
picture.pack()
material = data.materials.new("painted")
nodes = material.node_tree.nodes
texture = nodes.new("ShaderNodeTexImage")
texture.image = picture
material.node_tree.links.new(texture.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
ball.data.materials.append(material)
def light(kind, energy, place):
    lamp = data.objects.new(kind.title(), data.lights.new(kind.title(), kind))
    lamp.data.energy, lamp.location = energy, place
    scene.collection.objects.link(lamp)
light("POINT", 100.0, (2, -2, 3))
light("SUN", 2.0, (0, 0, 5))
light("SPOT", 50.0, (0, 0, 4))
camera = data.objects.new("Camera", data.cameras.new("Camera"))
camera.location, camera.rotation_euler = (4, -5, 3), (math.radians(65), 0, math.radians(38))
scene.collection.objects.link(camera)
scene.camera, scene.render.resolution_x, scene.render.resolution_y = camera, 640, 480
"""
"""A floor, a monkey with a modifier, a ball below it that a packed picture covers, three lights and a camera."""
SAVE = """
folder = sys.argv[1]
bpy.ops.wm.save_as_mainfile(filepath=folder + "/room.blend")
"""
FACTS = """
bpy.ops.wm.usd_export(filepath=folder + "/room.usdz")
bpy.ops.wm.usd_export(filepath=folder + "/room.usda")
graph = bpy.context.evaluated_depsgraph_get()
facts = {}
for thing in scene.objects:
    if thing.type == "MESH":
        own = thing.evaluated_get(graph)
        points = [own.matrix_world @ vertex.co for vertex in own.data.vertices]
        facts[thing.name] = [[f(p[k] for p in points) for k in range(3)] for f in (min, max)]
"""
WRITE = """
open(folder + "/facts.json", "w").write(json.dumps(facts))
"""


def room(folder: Path) -> dict[str, Box]:
    """Writes ROOM into the folder as room.blend, room.usda and room.usdz. Returns the box of each mesh, by Blender."""
    written(folder, ROOM, FACTS + WRITE)
    facts: dict[str, Box] = json.loads((folder / "facts.json").read_bytes())
    return facts


def written(folder: Path, scene: str, then: str = "") -> Path:
    """Writes the scene that a script makes into the folder, as room.blend, which is returned."""
    code = START + scene + SAVE + then
    done = subprocess.run([sys.executable, "-c", code, folder], capture_output=True, text=True, cwd="/", check=False)
    assert done.returncode == 0, done.stderr
    return folder / "room.blend"
