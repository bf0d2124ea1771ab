"""A file that holds a whole scene: its nodes, cameras and lights, in metres with +y up, as any format is read.

It is made beside the file's mesh by the process that reads files that are not trusted, is checked on arrival and stored
with the upload. The mesh's parts stay as they are: `SceneFile.parts` names the node of each, so that one node, or all
but some nodes, is a mesh of its own (`mesh_of_node`, `mesh_of_rest`).
"""

import re
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, JsonValue, model_validator

from scene_attack.scenes.mesh import FIT_RADIUS, Doubles, Part, ball
from scene_attack.text import visible

MAX_DEPTH = 64
"""Largest number of nodes within each other."""
MAX_LIGHTS = 1_000
MAX_CAMERAS = 1_000
GENERATOR, DESCRIPTION = "scene-attack", "description"
"""The generator of a file that this project wrote, and the name in its scene's extras of the scene's description."""
THIS_FILE = "this file"
"""The name in such a description of a mesh that is in the file alone."""
LONGEST_NAME = 100
Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
Name = Annotated[str, Field(max_length=LONGEST_NAME)]
Phrase = Annotated[str, Field(max_length=300)]
Index = Annotated[int, Field(ge=0)]


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Extent(_Record):
    """Where triangles are: the middle and sides of their bounding box, and the radius of the ball about that middle
    that holds them; metres."""

    centre: Vector
    size: Vector
    radius: Annotated[Finite, Field(gt=0)]


class Node(_Record):
    """A node. Its number is its place in the list, in which a parent is before its children.

    triangles: those of its own. extent: that of its own triangles and of those below it; None if there are none.
    """

    name: Name
    parent: Index | None
    triangles: Index
    extent: Extent | None


class FileCamera(_Record):
    """A perspective camera at a node. forward and up are unit vectors; field_of_view is vertical, radians; aspect is
    width by height, None where the file leaves it open."""

    node: Index
    name: Name
    position: Vector
    forward: Vector
    up: Vector
    field_of_view: Finite
    aspect: Annotated[Finite, Field(gt=0)] | None


class FileLight(_Record):
    """A light at a node. intensity: in candela, of a directional light in lux, for all channels together; colored:
    whether its colour is not white. direction: that in which it shines, a unit vector. Angles are radians."""

    node: Index
    name: Name
    kind: Literal["point", "directional", "spot"]
    intensity: Annotated[Finite, Field(ge=0)]
    colored: bool
    position: Vector
    direction: Vector
    inner_angle: Finite = 0.0
    outer_angle: Finite = 0.0


class SceneFile(_Record):
    """The scene in a file, or in `unusable` why there is none.

    parts: the node of each part of the file's mesh. extent: that of all of them. left_out: what a scene of it does not
    show. own: the description of the scene, if this project wrote the file.
    """

    nodes: Annotated[tuple[Node, ...], Field(max_length=10_000)] = ()
    parts: tuple[Index, ...] = ()
    extent: Extent | None = None
    cameras: Annotated[tuple[FileCamera, ...], Field(max_length=MAX_CAMERAS)] = ()
    lights: Annotated[tuple[FileLight, ...], Field(max_length=MAX_LIGHTS)] = ()
    left_out: Annotated[tuple[Phrase, ...], Field(max_length=40)] = ()
    own: dict[str, JsonValue] | None = None
    unusable: Phrase = ""

    @model_validator(mode="after")
    def _is_a_tree(self) -> Self:
        if any(node.parent is not None and node.parent >= k for k, node in enumerate(self.nodes)):
            raise ValueError("a node is before its parent")
        if any(part >= len(self.nodes) for part in self.parts):
            raise ValueError("a part is of no node")
        return self

    def below(self, nodes: Sequence[int]) -> set[int]:
        """Returns these nodes and all below them."""
        found = set(nodes)
        for k, node in enumerate(self.nodes):
            if node.parent in found:
                found.add(k)
        return found

    def label(self, node: int) -> str:
        """The name of a node for people and error messages: its number where it has none."""
        return self.nodes[node].name or f"#{node}"


def readable(name: Any) -> str:
    """Returns a name of a file as a line of at most LONGEST_NAME characters; "" for what is no text."""
    text = visible(name).replace("\n", " ").replace("\t", " ") if isinstance(name, str) else ""
    return text.encode("utf-8", "replace").decode().strip()[:LONGEST_NAME]


def extents(
    owners: Sequence[int], parents: Sequence[int | None], parts: tuple[Part, ...], whole: Extent
) -> list[Extent | None]:
    """Returns the extent of each node's triangles with those below it, given the node of each part, the parent of each
    node, the parts as they are fitted to the frame, and where all of them are in metres."""
    mine: list[list[int]] = [[] for _ in parents]
    for part, owner in enumerate(owners):
        mine[owner].append(part)
    for node in reversed(range(len(parents))):  # a node after all that are below it
        parent = parents[node]
        if parent is not None and mine[node]:
            mine[parent] = sorted((*mine[parent], *mine[node]))
    known: dict[tuple[int, ...], Extent | None] = {(): None}
    for numbers in map(tuple, mine):
        if numbers not in known:
            known[numbers] = _extent(tuple(parts[k] for k in numbers), whole)
    return [known[tuple(numbers)] for numbers in mine]


def _extent(parts: tuple[Part, ...], whole: Extent) -> Extent | None:
    """Where some of the parts that are fitted to the frame together are in metres; None if that is one point."""
    metres = whole.radius / FIT_RADIUS
    low, high, radius = ball(parts)
    if not radius * metres > 0:
        return None
    centre = (low + high) / 2 * metres + whole.centre
    return Extent(centre=vector(centre), size=vector((high - low) * metres), radius=radius * metres)


def vector(values: Doubles) -> Vector:
    """Returns three numbers as a tuple."""
    x, y, z = (float(value) for value in np.asarray(values, np.float64))
    return x, y, z


def as_known(scene: SceneFile, file: str, has_mesh: Callable[[str], bool], has_map: Callable[[str], bool]) -> SceneFile:
    """Returns the scene of the upload `file`, in whose own description the meshes that there are not here are those of
    the file, and an environment map that there is not here is the default one."""
    if scene.own is None:
        return scene
    own = dict(scene.own)
    lights = own.get("lights")
    light = lights.get("environment") if isinstance(lights, dict) else None
    if isinstance(lights, dict) and isinstance(light, dict) and not has_map(str(light.get("map"))):
        own["lights"] = {name: part for name, part in lights.items() if name != "environment"}
        missing = f"the environment map {str(light.get('map'))[:200]!r}, which is not here"
        scene = scene.model_copy(update={"left_out": (*scene.left_out, missing)})
    for part, word in (("objects", "object"), ("fixed", "fixed")):
        listed = own.get(part)
        if listed is None:
            continue
        own[part] = [
            thing
            if not isinstance(thing, dict) or has_mesh(str(thing.get("mesh")))
            else thing | _as_drawn(scene, file, f"{word} {k}")
            for k, thing in enumerate(listed if isinstance(listed, list) else [])
        ]
    return scene.model_copy(update={"own": own})


def _as_drawn(scene: SceneFile, file: str, name: str) -> dict[str, Any]:
    """The mesh and the place of the node that stands for a part of a description, whose colour is in its materials."""
    for k, node in enumerate(scene.nodes):
        if node.name == name and node.parent is None and node.extent is not None:
            place = {"translation": list(node.extent.centre), "scale": node.extent.radius / FIT_RADIUS}
            return {"mesh": mesh_of_node(file, k), "rotation": [0, 0, 0], "color": [1, 1, 1], **place}
    return {}


_NODES = re.compile(r"(?P<upload>sha256:[0-9a-f]{64})#(?:(?P<node>[0-9]{1,5})|!(?P<others>[0-9]{1,5}(?:,[0-9]{1,5})*))")


def mesh_of_node(file: str, node: int) -> str:
    """The name of the mesh of a node, with all below it, of the upload `file`."""
    return f"{file}#{node}"


def mesh_of_rest(file: str, nodes: Sequence[int]) -> str:
    """The name of the mesh of all but these nodes and those below them, in the frame of the whole file's mesh."""
    return f"{file}#!{','.join(map(str, nodes))}"


def upload_of(mesh: str) -> str:
    """The name of the upload that a mesh's name is about; other names as they are."""
    match = _NODES.fullmatch(mesh)
    return mesh if match is None else match["upload"]


def parts_named(mesh: str, scene: SceneFile) -> list[int] | None:
    """Returns the numbers of the parts that a node's mesh has, or the mesh of the rest; None for a node that there is
    not, and for a name that has no node."""
    match = _NODES.fullmatch(mesh)
    if match is None:
        return None
    named = [int(number) for number in (match["node"] or match["others"]).split(",")]
    if max(named) >= len(scene.nodes):
        return None
    below = scene.below(named)
    return [k for k, owner in enumerate(scene.parts) if (owner in below) == (match["node"] is not None)]


def node_of(mesh: str) -> int | None:
    """Returns the node that a mesh's name is about; None for the name of the rest, and for others."""
    match = _NODES.fullmatch(mesh)
    return None if match is None or match["node"] is None else int(match["node"])
