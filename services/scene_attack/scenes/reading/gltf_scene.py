"""Reads what a glTF 2.0 file holds beside its triangles: the tree of its nodes, its cameras, and its lights
(KHR_lights_punctual)."""

import json
from math import pi
from typing import Any

import numpy as np

from scene_attack.errors import Unreadable, shortened
from scene_attack.scenes.mesh import FIT_RADIUS, Doubles, ball
from scene_attack.scenes.reading.gltf import LIGHTS, GltfFile, PlacedNode, Placement, elements, number, numbers
from scene_attack.scenes.reading.isolated import listed
from scene_attack.scenes.scene_file import (
    DESCRIPTION,
    GENERATOR,
    MAX_CAMERAS,
    MAX_DEPTH,
    MAX_LIGHTS,
    Extent,
    FileCamera,
    FileLight,
    Node,
    SceneFile,
    extents,
    readable,
    vector,
)

INSTANCES = "EXT_mesh_gpu_instancing"
LONGEST_DESCRIPTION = 1_000_000
"""Characters of a description; a picture that is its background may have 400,000."""
LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of linear RGB in the luminance (ITU-R BT.709)."""


def read_scene(file: GltfFile, placement: Placement) -> SceneFile:
    """Returns the scene of a file whose mesh was read. What makes its scene unusable is said in it, since the mesh is
    one all the same."""
    try:
        return _scene(file, placement)
    except Unreadable as error:
        return SceneFile(unusable=shortened(error))


def _scene(file: GltfFile, placement: Placement) -> SceneFile:
    parents = [node.parent for node in placement.nodes]
    _check_depth(parents)
    low, high, _ = ball(placement.parts)
    size = (high - low) * placement.radius / FIT_RADIUS
    whole = Extent(centre=vector(placement.centre), size=vector(size), radius=placement.radius)
    triangles = [0] * len(parents)
    for owner, part in zip(placement.owners, placement.parts, strict=True):
        triangles[owner] += len(part.faces)
    cameras: list[FileCamera] = []
    lights: list[FileLight] = []
    left_out: list[str] = []
    for index, node in enumerate(placement.nodes):
        name = readable(node.entry.get("name"))
        label = repr(name) if name else f"nodes[{node.number}]"
        own = node.entry.get("extensions", {})
        if not isinstance(own, dict):
            raise Unreadable(f"nodes[{node.number}].extensions is not an object")
        if INSTANCES in own:
            raise Unreadable(f"node {label} has instances ({INSTANCES}), which are not read; write each as a node")
        if "skin" in node.entry:
            left_out.append(f"the pose of {label}: it is drawn as it was before its skeleton bends it")
        if "mesh" in node.entry and _has_targets(file, node.entry["mesh"]):
            left_out.append(f"the morph targets of {label}: it is drawn in its first shape")
        if "camera" in node.entry:
            cameras += _camera(file, node, index, name)
        if LIGHTS in own:
            lights.append(_light(file, own[LIGHTS], node, index, name))
    for what, most in ((cameras, MAX_CAMERAS), (lights, MAX_LIGHTS)):
        if len(what) > most:
            raise Unreadable(f"it has {len(what):,} cameras or lights; at most {most:,} of each are taken")
    own = _own(file)
    return SceneFile(
        nodes=tuple(
            Node(name=readable(node.entry.get("name")), parent=node.parent, triangles=count, extent=extent)
            for node, count, extent in zip(
                placement.nodes,
                triangles,
                extents(placement.owners, parents, placement.parts, whole),
                strict=True,
            )
        ),
        parts=tuple(placement.owners),
        extent=whole,
        cameras=tuple(cameras),
        lights=tuple(lights),
        left_out=listed(left_out),
        own=own,
    )


def _own(file: GltfFile) -> dict[str, Any] | None:
    """The description of the scene that this project's exports have; a program that changed the file signed it."""
    asset, chosen = file.tree.get("asset"), file.tree.get("scene", 0)
    if not isinstance(asset, dict) or asset.get("generator") != GENERATOR or not file.array("scenes"):
        return None
    extras = file.item("scenes", chosen).get("extras")
    described = extras.get(DESCRIPTION) if isinstance(extras, dict) else None
    return described if isinstance(described, dict) and len(json.dumps(described)) <= LONGEST_DESCRIPTION else None


def _check_depth(parents: list[int | None]) -> None:
    depths: list[int] = []
    for parent in parents:
        depths.append(1 if parent is None else depths[parent] + 1)
    if max(depths) > MAX_DEPTH:
        raise Unreadable(f"its nodes are {max(depths):,} deep within each other; at most {MAX_DEPTH} are taken")


def _has_targets(file: GltfFile, mesh: int) -> bool:
    return any(entry.get("targets") for _, entry, _ in file.primitives(mesh))


def _camera(file: GltfFile, node: PlacedNode, index: int, name: str) -> list[FileCamera]:
    """The perspective camera of a node; none for another kind."""
    where = f"cameras[{node.entry['camera']}]"
    entry = file.item("cameras", node.entry["camera"])
    lens = entry.get("perspective")
    if entry.get("type") != "perspective" or not isinstance(lens, dict):
        return []
    forward = _unit(-node.transform[:3, 2], f"nodes[{node.number}]")
    up = node.transform[:3, 1] - forward * (forward @ node.transform[:3, 1])
    return [
        FileCamera(
            node=index,
            name=name or readable(entry.get("name")),
            position=vector(node.transform[:3, 3]),
            forward=vector(forward),
            up=vector(_unit(up, f"nodes[{node.number}]")),
            field_of_view=number(lens, "yfov", 0.0, 1e-3, pi - 1e-3, f"{where}.perspective"),
            aspect=None
            if "aspectRatio" not in lens
            else number(lens, "aspectRatio", 1.0, 1e-3, 1e3, f"{where}.perspective"),
        )
    ]


def _light(file: GltfFile, reference: Any, node: PlacedNode, place: int, name: str) -> FileLight:
    holder = file.tree.get("extensions", {})
    listed = elements(holder.get(LIGHTS, {}), "lights", LIGHTS) if isinstance(holder, dict) else []
    index = reference.get("light") if isinstance(reference, dict) else None
    if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < len(listed):
        raise Unreadable(f"nodes[{node.number}] refers to the light {index!r}, which is not there")
    where, entry = f"{LIGHTS}.lights[{index}]", listed[index]
    if not isinstance(entry, dict) or entry.get("type") not in ("point", "directional", "spot"):
        raise Unreadable(f"{where} is no point, directional or spot light")
    color = numbers(entry, "color", (1.0, 1.0, 1.0), 0, 1e6, where)
    light = FileLight(
        node=place,
        name=name or readable(entry.get("name")),
        kind=entry["type"],
        intensity=number(entry, "intensity", 1.0, 0, 1e12, where) * float(color @ LUMINANCE),
        colored=bool((color != color[0]).any()),
        position=vector(node.transform[:3, 3]),
        direction=vector(_unit(-node.transform[:3, 2], f"nodes[{node.number}]")),
    )
    if light.kind != "spot":
        return light
    cone = entry.get("spot", {})
    inner = number(cone, "innerConeAngle", 0.0, 0, pi / 2, f"{where}.spot")
    outer = number(cone, "outerConeAngle", pi / 4, 0, pi / 2, f"{where}.spot")
    if inner >= outer:
        raise Unreadable(f"{where}.spot.innerConeAngle is {inner:g}, which is not below outerConeAngle, {outer:g}")
    return light.model_copy(update={"inner_angle": inner, "outer_angle": outer})


def _unit(values: Doubles, where: str) -> Doubles:
    length = float(np.linalg.norm(values))
    if not length > 0:
        raise Unreadable(f"{where} is scaled to nothing, so that its camera or light has no direction")
    return values / length
