"""Converts a file of Blender or USD to glTF, in Blender.

Blender's exporter writes what a scene is made of; what a picture of it shows can differ: modifiers and collections
have settings for rendering alone, and instances, curves and posed parts become meshes only when they are drawn. So the
scene is first made of plain things: each mesh that would be rendered, where it is, below nodes with the names of the
file's objects. The exporter then writes their surfaces, the lamps and the cameras.
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy

SHOWN = ("SUN", "POINT", "SPOT")
"""Kinds of lights that glTF has."""
FOLLOWED = ("TEX_IMAGE", "RGB", "MIX", "MIX_RGB", "VERTEX_COLOR", "ATTRIBUTE", "GROUP", "REROUTE")
"""Kinds of nodes in which the exporter finds the colour of a surface."""
DUPLICATORS = ("VERTS", "FACES")
"""Ways of an object to show copies of its children, and not the children."""


def convert(file: Path, out: Path) -> list[str]:
    """Writes the file's scene; returns what it lacks. Raises RuntimeError if Blender cannot read it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for name in list(bpy.context.preferences.addons.keys()):
        if name != "io_scene_gltf2":
            bpy.ops.preferences.addon_disable(module=name)
    if file.suffix.lower() == ".blend":
        bpy.ops.wm.open_mainfile(filepath=os.fspath(file), load_ui=False, use_scripts=False)
    else:
        _import_usd(os.fspath(file))
    missing = list(_of_file(bpy.context.scene))
    plain = _plain(bpy.context.scene)
    missing += _of_things(plain)
    if not plain.meshes:
        raise RuntimeError("it holds no mesh that Blender would render")
    bpy.ops.export_scene.gltf(
        filepath=os.fspath(out),
        export_format="GLB",
        export_cameras=True,
        export_lights=True,
        export_animations=False,
        export_skins=False,
        export_morph=False,
        use_active_scene=True,
    )
    return missing


def _import_usd(file: str) -> None:
    """Makes the scene of a USD file: with all names of its nodes, its surfaces subdivided, and its camera's aspect."""
    bpy.ops.wm.usd_import(
        filepath=file, import_textures_mode="IMPORT_PACK", import_subdivision=True, merge_parent_xform=False
    )
    cameras = [thing.data for thing in bpy.context.scene.objects if thing.type == "CAMERA"]
    if cameras and cameras[0].sensor_height > 0:
        render = bpy.context.scene.render
        render.resolution_y = 1000
        render.resolution_x = round(1000 * cameras[0].sensor_width / cameras[0].sensor_height)


@dataclass
class Plain:
    """The things that a scene was made of: objects of meshes in world space, of lamps, and of cameras."""

    meshes: list[Any] = field(default_factory=list)
    lamps: list[Any] = field(default_factory=list)
    cameras: list[Any] = field(default_factory=list)


@dataclass(frozen=True)
class _Found:
    """A thing that would be rendered. kind: MESH, LIGHT or CAMERA. place: world from the thing, 4 × 4. above: the names
    of the objects that it is below, from the nearest on.
    """

    name: str
    kind: str
    data: Any
    place: Any
    above: tuple[str, ...]


def _plain(scene: Any) -> Plain:
    """Makes the scene of plain things, and returns them."""
    _show_as_rendered()
    bpy.context.view_layer.update()
    found = list(_found(bpy.context.evaluated_depsgraph_get()))
    active = None if scene.camera is None else scene.camera.name
    found.sort(key=lambda one: (one.kind == "CAMERA", one.name != active))  # the first camera is a scene's own
    bpy.data.batch_remove(list(bpy.data.objects))
    plain, nodes = Plain(), dict[str, Any]()
    for one in found:
        thing = bpy.data.objects.new(one.name, one.data)
        scene.collection.objects.link(thing)
        if one.kind == "MESH":
            one.data.transform(one.place)
            if one.place.determinant() < 0:
                one.data.flip_normals()
            plain.meshes.append(thing)
            nodes.setdefault(one.name, thing)
        else:
            thing.matrix_world = one.place
            (plain.lamps if one.kind == "LIGHT" else plain.cameras).append(thing)
    for one, mesh in zip((one for one in found if one.kind == "MESH"), plain.meshes, strict=True):
        thing = mesh
        for name in one.above:
            if name not in nodes:
                nodes[name] = bpy.data.objects.new(name, None)
                scene.collection.objects.link(nodes[name])
            if nodes[name] is not thing:  # a library's object may have the same name
                thing.parent = nodes[name]
                thing = nodes[name]
    return plain


def _show_as_rendered() -> None:
    """Has the viewport, whose state is what can be had, show what a picture shows."""
    for thing in bpy.data.objects:
        thing.hide_viewport = thing.hide_render
        thing.show_instancer_for_viewport = thing.show_instancer_for_render
        for modifier in thing.modifiers:
            modifier.show_viewport = modifier.show_render
            if hasattr(modifier, "render_levels"):
                modifier.levels = modifier.render_levels
    for collection in bpy.data.collections:
        collection.hide_viewport = collection.hide_render
    for layer in _layers(bpy.context.view_layer.layer_collection):
        layer.hide_viewport = False
    for thing in bpy.context.view_layer.objects:
        thing.hide_set(False)


def _layers(layer: Any) -> Iterator[Any]:
    yield layer
    for child in layer.children:
        yield from _layers(child)


def _found(graph: Any) -> Iterator[_Found]:
    """All meshes, lamps and cameras, evaluated and copied. Each instance is a thing below what shows it; the mesh of a
    curve or a text is given as an instance of it, in its place.
    """
    for instance in graph.object_instances:
        thing, instancer = instance.object, instance.parent if instance.is_instance else None
        if thing.type not in ("MESH", "LIGHT", "CAMERA") or not instance.show_self:
            continue
        if thing.type == "MESH" and not thing.visible_camera:
            continue
        name, above = thing.name, [parent.name for parent in _ancestors(thing)]
        if instancer is None and any(parent.instance_type in DUPLICATORS for parent in _ancestors(thing)):
            continue  # only its copies are shown
        if instancer is not None:
            above = [parent.name for parent in _ancestors(instancer)]
            if instance.matrix_world != instancer.matrix_world or instancer.original != thing.original:
                above.insert(0, instancer.name)
                name = f"{name} instance" if instancer.original == thing.original else name  # of geometry nodes
        if thing.type == "MESH":
            data = bpy.data.meshes.new_from_object(thing, depsgraph=graph)
            for number, slot in enumerate(thing.material_slots):
                if slot.link == "OBJECT" and number < len(data.materials):
                    data.materials[number] = None if slot.material is None else slot.material.original
            if not data.polygons:
                continue
        else:
            data = thing.original.data.copy()
        yield _Found(name, thing.type, data, instance.matrix_world.copy(), tuple(above))


def _ancestors(thing: Any) -> Iterator[Any]:
    while (thing := thing.parent) is not None:
        yield thing


def _of_file(scene: Any) -> Iterator[str]:
    """Sentences on what of a file the scene will lack, whatever is in the picture."""
    for library in bpy.data.libraries:
        if library.is_missing:
            yield f"what is linked from {library.filepath}: it is not there, or outside the folder of the file"
    for image in bpy.data.images:
        if image.source in ("FILE", "TILED") and image.users and not image.packed_file and not image.size[0]:
            yield f"the image {image.filepath}: it is not there, or outside the folder of the file"
    if scene.world is not None:
        yield f"the light of the world {scene.world.name}"
    if bpy.data.texts or any(_drivers()):
        yield "what its scripts and Python drivers would do: none is run"
    if scene.unit_settings.scale_length != 1:
        length = scene.unit_settings.scale_length
        yield f"its unit: one is {length:g} m in the file, and one metre in what is written"


def _drivers() -> Iterator[bool]:
    for kind in ("objects", "meshes", "materials", "lights", "cameras", "scenes", "shape_keys", "node_groups"):
        for owner in getattr(bpy.data, kind):
            data = owner.animation_data
            yield data is not None and any(curve.driver.type == "SCRIPTED" for curve in data.drivers)


def _of_things(plain: Plain) -> Iterator[str]:
    """Sentences on what of the things glTF cannot say. Prepares the lamps for the exporter."""
    for lamp in plain.lamps:
        if lamp.data.type in SHOWN:
            yield from _prepared(lamp)
        else:
            yield f"the {lamp.data.type.lower()} light {lamp.name}: glTF has point, directional and spot lights"
    for camera in plain.cameras:
        if camera.data.type != "PERSP":
            yield f"the camera {camera.name}: it is not a perspective one"
        elif camera.data.shift_x or camera.data.shift_y:
            yield f"the shift of the camera {camera.name}"
    used = {slot.material for thing in plain.meshes for slot in thing.material_slots if slot.material is not None}
    for material in sorted(used, key=lambda one: one.name):
        output = None if material.node_tree is None else material.node_tree.get_output_node("CYCLES")
        links = () if output is None else output.inputs["Surface"].links
        surface = links[0].from_node if links else None
        if surface is None or surface.type != "BSDF_PRINCIPLED":
            yield f"the surface of the material {material.name}: it is no Principled BSDF"
        elif any(node.type == "TEX_IMAGE" and node.image is None for node in material.node_tree.nodes):
            yield f"an image of the material {material.name}: it is not there, or outside the folder of the file"
        elif any(link.from_node.type not in FOLLOWED for link in surface.inputs["Base Color"].links):
            yield f"the colour of the material {material.name}: glTF has colours and pictures, and no patterns"


def _prepared(lamp: Any) -> Iterator[str]:
    """Gives a lamp its strength in watts, and white light; says what is lost. Blender's exporter fails at lights whose
    power is of an area or whose colour is of a temperature, and does not take nodes for what they are.
    """
    light = lamp.data
    light.use_temperature = False
    if not light.normalize:
        light.energy *= light.area(matrix_world=lamp.matrix_world)
        light.normalize = True
    if light.use_nodes:
        emissions = [node for node in light.node_tree.nodes if node.type == "EMISSION"]
        if len(emissions) == 1 and not any(socket.is_linked for socket in emissions[0].inputs):
            light.energy *= emissions[0].inputs["Strength"].default_value
        else:
            yield f"the nodes of the light {lamp.name}"
        light.use_nodes = False
