"""The process that converts a file to glTF: `python -m scene_attack_blender.conversion <file> <folder>`. It writes
`scene.glb` into the folder, and `notes.json`: {"missing": what the file has and the scene has not, "error": why there
is no scene, or null, "unconfined": why it could have read other files, or null}.

The file may be anybody's. None of its scripts is run, and files outside its own folder are not read where the kernel
can refuse it: what refers to them is missing.
"""

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from scene_attack.confinement import die_with_parent, forbid_files

SYSTEM = ("/usr", "/lib", "/lib64")
"""Folders of libraries, which Blender and the modules of its exporter load."""


def confine(file: Path, folder: Path) -> str | None:
    """Refuses this process all files but those beside `file`, those in `folder` and the programs' own. Returns why the
    kernel cannot, or None.

    Landlock confines the thread that asks and those that it starts from then on. Blender reads files in threads of its
    own, the first of which it starts when it is imported: this comes before.
    """
    programs = {*SYSTEM, sys.base_prefix, sys.prefix, *sys.path}
    try:
        forbid_files([*(Path(name) for name in programs if Path(name).is_dir()), file.parent], [folder])
    except OSError as error:
        return str(error)
    return None


if __name__ == "__main__":
    die_with_parent()
    unconfined = confine(Path(sys.argv[1]), Path(sys.argv[2]))

import bpy  # noqa: E402

SCENE, NOTES = "scene.glb", "notes.json"
"""The files that are written."""
SHOWN = ("SUN", "POINT", "SPOT")
"""Kinds of lights that glTF has."""
WITH_FACES = ("MESH", "CURVE", "SURFACE", "FONT", "EMPTY")
"""Kinds of objects that may have faces; an empty can stand for a collection."""


def convert(file: Path, folder: Path) -> list[str]:
    """Writes the file's scene; returns what it lacks. Raises RuntimeError if Blender cannot read it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for name in list(bpy.context.preferences.addons.keys()):
        if name != "io_scene_gltf2":
            bpy.ops.preferences.addon_disable(module=name)
    if file.suffix.lower() == ".blend":
        bpy.ops.wm.open_mainfile(filepath=os.fspath(file), load_ui=False, use_scripts=False)
    else:
        _import_usd(os.fspath(file))
    for thing in bpy.context.scene.objects:
        if thing.type == "LIGHT":
            _as_the_exporter_takes_it(thing)
    notes = list(missing(bpy.context.scene))
    if not any(thing.type in WITH_FACES for thing in bpy.context.scene.objects):
        raise RuntimeError("it holds no mesh")
    bpy.ops.export_scene.gltf(
        filepath=os.fspath(folder / SCENE),
        export_format="GLB",
        export_cameras=True,
        export_lights=True,
        export_apply=True,
        export_gn_mesh=True,
        export_animations=False,
        export_skins=False,
        export_morph=False,
        use_active_scene=True,
        use_renderable=True,
    )
    return notes


def _import_usd(file: str) -> None:
    """Makes the scene of a USD file: with all names of its nodes, its surfaces subdivided, and its camera's aspect."""
    bpy.ops.wm.usd_import(
        filepath=file, import_textures_mode="IMPORT_PACK", import_subdivision=True, merge_parent_xform=False
    )
    cameras = [thing.data for thing in bpy.context.scene.objects if thing.type == "CAMERA"]
    if cameras:
        render = bpy.context.scene.render
        render.resolution_y = 1000
        render.resolution_x = round(1000 * cameras[0].sensor_width / cameras[0].sensor_height)


def missing(scene: Any) -> Iterator[str]:
    """Sentences on what the converted scene will lack."""
    for library in bpy.data.libraries:
        if library.is_missing:
            yield f"what is linked from {library.filepath}: it is not there, or outside the folder of the file"
    for image in bpy.data.images:
        if image.source in ("FILE", "TILED") and image.users and not image.packed_file and not image.size[0]:
            yield f"the image {image.filepath}: it is not there, or outside the folder of the file"
    for thing in scene.objects:
        if thing.type == "LIGHT" and thing.data.type not in SHOWN:
            yield f"the {thing.data.type.lower()} light {thing.name}: glTF has point, directional and spot lights"
    used = {slot.material for thing in scene.objects for slot in thing.material_slots if slot.material is not None}
    for material in sorted(used, key=lambda one: one.name):
        tree = material.node_tree
        if tree is not None and not any(node.type == "BSDF_PRINCIPLED" for node in tree.nodes):
            yield f"the surface of the material {material.name}: it is no Principled BSDF"
    if scene.world is not None:
        yield f"the light of the world {scene.world.name}"
    if bpy.data.texts or any(_drivers()):
        yield "what its scripts and Python drivers would do: none is run"
    if scene.unit_settings.scale_length != 1:
        length = scene.unit_settings.scale_length
        yield f"its unit: one is {length:g} m in the file, and one metre in what is written"


def _as_the_exporter_takes_it(lamp: Any) -> None:
    """Exporters of Blender 5.0 fail at lights whose power is of an area, and whose colour is of a temperature.
    Requests have white lights alone.
    """
    light = lamp.data
    light.use_temperature = False
    if not light.normalize:
        light.energy *= light.area(matrix_world=lamp.matrix_world)
        light.normalize = True


def _drivers() -> Iterator[bool]:
    for kind in ("objects", "meshes", "materials", "lights", "cameras", "scenes", "shape_keys", "node_groups"):
        for owner in getattr(bpy.data, kind):
            data = owner.animation_data
            yield data is not None and any(curve.driver.type == "SCRIPTED" for curve in data.drivers)


if __name__ == "__main__":
    found, error = [], None
    try:
        found = convert(Path(sys.argv[1]), Path(sys.argv[2]))
    except RuntimeError as raised:
        lines = [line for line in str(raised).splitlines() if line.strip() and not line.startswith("Location: ")]
        error = " ".join((lines[-1] if "Traceback" in lines[0] else " ".join(lines)).removeprefix("Error: ").split())
    notes = {"missing": found, "error": error, "unconfined": unconfined}
    Path(sys.argv[2], NOTES).write_text(json.dumps(notes), "utf-8")
