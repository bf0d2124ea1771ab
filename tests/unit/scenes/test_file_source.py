"""A scene in a file: where its parts are drawn, how it is lit, what may change, and what is said of what is not shown.

The reference is glTF's own definition: points are put through the nodes' matrices and the file's camera in float64,
by scipy's rotations, and lights are summed in lux.
"""

import json
import struct
from math import cos, pi, tan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.linalg import norm
from numpy.typing import NDArray
from scipy.spatial.distance import directed_hausdorff
from scipy.spatial.transform import Rotation

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.pose import lengths
from scene_attack.runs.campaign_spec import parse as parse_campaign
from scene_attack.runs.check import uploads_in
from scene_attack.runs.spec import JobSpec, names_in, parse, scene_name
from scene_attack.scenes.description import Scene
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import ResolvedScene, resolve
from scene_attack.scenes.scene_file import upload_of
from scene_attack_service.settings import Settings
from tests.unit.scenes.scene_files import SHEAR, Room, ball_points

ROUNDING = 3e-6
"""Of a point in metres: float32 holds a room of 14 m to 1e-6."""


@pytest.fixture
def library(tmp_path: Path) -> Library:
    return Library(Settings().cache_dir, tmp_path)


def job(library: Library, data: bytes, scene: dict[str, Any] | None = None, **source: Any) -> JobSpec:
    name = library.add_mesh(data, "glb").name
    given = {"source": {"format": "file", "file": name, **source}} | (scene or {})
    return parse({"scene": given, "attack": {"renderer": "pyrender"}}, names_in(library))


def refused(library: Library, data: bytes, **source: Any) -> InvalidRequest:
    with pytest.raises(InvalidRequest) as caught:
        job(library, data, **source)
    return caught.value


def drawn(scene: ResolvedScene) -> dict[str, NDArray[np.float64]]:
    """The vertices of all that is drawn in scene units, by name."""
    return {
        placed.name: np.concatenate(
            [
                part.vertices.astype(np.float64) @ placed.model[:3, :3].T + placed.model[:3, 3]
                for part in placed.mesh.parts
            ]
        )
        for placed in scene.placed
    }


def seen(points: NDArray[np.float64], matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    clip = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ matrix.T
    image: NDArray[np.float64] = clip[:, :2] / clip[:, 3:]
    return image


def middle(points: NDArray[np.float64]) -> NDArray[np.float64]:
    of_box: NDArray[np.float64] = (points.min(axis=0) + points.max(axis=0)) / 2
    return of_box


def apart(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """The largest distance of a point of one set from the nearest of the other."""
    return max(directed_hausdorff(first, second)[0], directed_hausdorff(second, first)[0])


BALL = ball_points() + np.array([-1, 0.5, 0])
LAMP = (ball_points() @ Rotation.from_euler("z", 0.8).as_matrix().T + np.array([0, 0.4, 0])) * SHEAR["scale"]
LAMP = LAMP + np.array([1.5, 0, -1])
"""The room's balls in the world, metres; the second one is sheared by its parent's scale."""


@pytest.mark.parametrize(
    "turn", [(0.0, -0.3, 0.0), (0.2, -0.25, 0.3), (-0.1, -0.35, 2.0)], ids=["level", "turned", "rolled"]
)
def test_every_vertex_is_seen_where_the_files_own_camera_sees_it(library: Library, turn: tuple[float, ...]) -> None:
    room, rotation, position = Room().without("Camera"), Rotation.from_euler("YXZ", turn), np.array([0.3, 2.0, 6.0])
    room.camera(name="Camera", translation=position.tolist(), rotation=rotation.as_quat().tolist())
    scene = resolve(job(library, room.glb, change=["Ball", "Lamp"]).scene, library)
    lens = np.array([[1 / tan(0.4) / 1.5, 0, 0, 0], [0, 1 / tan(0.4), 0, 0], [0, 0, 1, 0], [0, 0, -1, 0]])
    view = np.eye(4)
    view[:3, :3], view[:3, 3] = rotation.as_matrix().T, -rotation.as_matrix().T @ position
    ours, theirs = scene.projection @ np.linalg.inv(scene.view), lens @ view
    points = drawn(scene)
    assert apart(seen(points["object 0"], ours), seen(BALL, theirs)) < 1e-5
    assert apart(seen(points["object 1"], ours), seen(LAMP, theirs)) < 1e-5
    assert scene.description.camera.size == (224, 336)
    assert scene.description.camera.distance == pytest.approx(1.8)


def test_the_origin_is_on_the_line_of_sight_and_one_scale_makes_scene_units(library: Library) -> None:
    spec = job(library, Room().glb, change=["Ball", "Lamp"])
    scene = resolve(spec.scene, library)
    points, scale = drawn(scene), spec.scene.source.model_dump()["scale"]  # type: ignore[union-attr]
    origin = middle(BALL) - middle(points["object 0"]) / scale
    assert apart(points["object 0"] / scale + origin, BALL) < ROUNDING
    assert apart(points["object 1"] / scale + origin, LAMP) < ROUNDING
    corners = points["fixed 0"] / scale + origin
    assert apart(corners, np.array([[-5.0, 0, -5], [5, 0, -5], [5, 0, 5], [-5, 0, 5]])) < ROUNDING
    own, around = lengths(scene)
    assert [round(length.scale * scale, 6) for length in (*own, around)] == [100, 100, 100]
    assert {length.unit for length in (*own, around)} == {"cm"}


def test_each_light_has_its_share_of_the_light_everywhere(library: Library) -> None:
    room = Room()
    spot = {"type": "spot", "intensity": 500, "spot": {"outerConeAngle": 0.9}}
    downwards = {"rotation": [-(0.5**0.5), 0, 0, 0.5**0.5], "scale": [2, 2, 2]}  # no light has a size
    room.light(spot, name="Spot", translation=[0, 3, 0], **downwards)
    spec = job(library, room.glb, change=["Ball", "Lamp"])
    stated = spec.scene.source.model_dump()  # type: ignore[union-attr]
    lights, scale = spec.scene.lights, stated["scale"]
    points = drawn(resolve(spec.scene, library))
    origin = middle(BALL) - middle(points["object 0"]) / scale
    for given, place, candela in ((lights.points[0], [2, 4, 2], 800), (lights.spots[0], [0, 3, 0], 500)):
        assert np.array(given.position) / scale + origin == pytest.approx(place, abs=1e-5)
        assert given.energy / scale**2 == pytest.approx(candela * stated["exposure"])
    assert lights.directional[0].energy == pytest.approx(3 * stated["exposure"])
    down = Rotation.from_quat([-0.5, 0, 0, 0.75**0.5]).apply([0, 0, -1])
    assert lights.directional[0].direction == pytest.approx(down, abs=1e-7)
    assert lights.environment.map == "lights"
    corners = np.concatenate([BALL, LAMP])
    away = middle(corners) - np.array([0, 3, 0])
    share = (-away[1] / np.linalg.norm(away) - cos(0.9)) / (1 - cos(0.9))
    radius = max(
        norm(middle(ball) - middle(corners)) + norm(ball - middle(ball), axis=1).max() for ball in (BALL, LAMP)
    )
    assert norm(away) < radius < norm(middle(corners) - np.array([2, 4, 2]))
    lux = 800 / norm(middle(corners) - np.array([2, 4, 2])) ** 2 + 3 + 500 / radius**2 * share**2
    assert stated["exposure"] * lux == pytest.approx(30 / 3**2, rel=1e-5)


def test_a_spot_that_hardly_reaches_the_objects_has_no_more_energy_than_a_light_may_have(library: Library) -> None:
    room = Room().without("Bulb", "Sun")
    spot = {"type": "spot", "intensity": 500, "spot": {"outerConeAngle": 0.3}}
    nearly_past = Rotation.from_euler("x", 0.2995 - pi / 2).as_quat().tolist()
    room.light(spot, name="Spot", translation=[-1, 4.5, 0], rotation=nearly_past)
    [light] = job(library, room.glb, change=["Ball"]).scene.lights.spots
    assert light.energy == pytest.approx(9_900)


def test_a_file_without_a_camera_is_seen_by_the_default_one_which_all_that_may_change_fits(library: Library) -> None:
    scene = resolve(job(library, Room().without("Camera").glb, change=["Ball", "Lamp"]).scene, library)
    ours = scene.projection @ np.linalg.inv(scene.view)
    points = drawn(scene)
    at = seen(np.concatenate([points["object 0"], points["object 1"]]), ours)
    assert 0.5 < np.abs(at).max() <= 0.9 + 1e-6
    assert scene.description.camera.model_dump() == {
        **Scene.model_fields["camera"].default.model_dump(),
        "distance": 1.8,
    }


def test_nodes_are_named_by_names_patterns_and_numbers(library: Library) -> None:
    def picked(*change: str) -> list[str]:
        return [thing.mesh.partition("#")[2] for thing in job(library, Room().glb, change=list(change)).scene.objects]

    assert picked("Ball") == picked("#1") == ["1"]
    assert picked("*a*") == ["1", "2"]  # the table's lamp is a part of the table
    assert picked("Ball", "Lamp") == ["1", "3"]
    brackets = job(library, changed(Ball={"name": "Ball[1]?"}), change=["B*[1]?"])
    assert [thing.mesh.partition("#")[2] for thing in brackets.scene.objects] == ["1"]
    whole = job(library, Room().glb)
    assert [thing.mesh.partition("#")[2] for thing in whole.scene.objects] == ["0", "1", "2"]
    assert whole.scene.fixed == ()


def test_an_object_has_all_that_is_below_its_node(library: Library) -> None:
    scenes = [resolve(job(library, Room().glb, change=["Ball", name]).scene, library) for name in ("Table", "Lamp")]
    table, lamp = (drawn(scene)["object 1"] for scene in scenes)
    assert np.array_equal(table, lamp)
    assert [scene.placed[-1].mesh.triangles for scene in scenes] == [2, 2]


def test_a_lone_root_without_triangles_stands_for_what_is_below_it(library: Library) -> None:
    room = Room()
    tree = room.writer.tree
    tree["scenes"][0]["nodes"] = [room.child(name="World", children=tree["scenes"][0]["nodes"])]
    assert [thing.mesh.partition("#")[2] for thing in job(library, room.glb).scene.objects] == ["1", "2", "3"]


def test_the_objects_are_called_as_the_nodes(library: Library) -> None:
    spec = job(library, Room().glb, change=["Ball", "Lamp"])
    titles = library.titles(thing.mesh for thing in spec.scene.objects)
    assert scene_name(spec.model_dump(mode="json"), titles) == "Ball, Lamp"
    assert scene_name(spec.model_dump(mode="json")).startswith("sha256:")


def test_what_a_request_states_takes_the_place_of_the_files(library: Library) -> None:
    stated = {"camera": {"size": [40, 60]}, "lights": {"ambient": 0.1}}
    whole, some = job(library, Room().glb), job(library, Room().glb, stated)
    assert some.scene.camera == whole.scene.camera.model_copy(update={"size": (40, 60)})
    assert some.scene.lights == whole.scene.lights.model_copy(update={"ambient": 0.1})


def test_a_stored_request_is_read_without_the_file_and_is_the_same(library: Library) -> None:
    spec = job(library, Room().glb, change=["Ball"])
    again = parse(spec.model_dump(mode="json"))
    assert again == spec
    assert {upload_of(thing.mesh) for thing in (*again.scene.objects, *again.scene.fixed)} == {again.scene.source.file}  # type: ignore[union-attr]


def test_the_strongest_of_a_hundred_lights_stay_and_the_others_are_said(library: Library) -> None:
    room = Room()
    for k in range(100):
        room.light({"type": "point", "intensity": 1 + k, "color": [1, 0.5, 0.5]}, name=f"L{k}", translation=[0, 3, 0])
    spec = job(library, room.glb, change=["Ball"])
    scale = spec.scene.source.model_dump()["scale"]  # type: ignore[union-attr]
    exposure = spec.scene.source.model_dump()["exposure"]  # type: ignore[union-attr]
    luminance = 0.2126 + 0.5 * (0.7152 + 0.0722)
    expected = [800, *(k * luminance for k in (100, 99, 98))]
    assert [light.energy / exposure / scale**2 for light in spec.scene.lights.points] == pytest.approx(expected)
    dropped, colour = spec.scene.source.left_out()  # type: ignore[union-attr]
    assert dropped.startswith("97 of 101 point lights, 'L96', 'L95', 'L94' and 94 more: they are dark")
    assert colour == "the colour of the lights 'L99', 'L98', 'L97': lights are white here"


def test_a_light_that_no_scene_can_hold_is_left_out_and_said(library: Library) -> None:
    room = Room()
    room.light({"type": "point", "intensity": 1e9}, name="Star", translation=[0, 5000, 0])
    spec = job(library, room.glb, change=["Ball"])
    assert len(spec.scene.lights.points) == 1
    assert "1 of 2 point lights, 'Star'" in str(spec.scene.source.model_dump()["missing"])  # type: ignore[union-attr]


@pytest.mark.parametrize("intensity", [500, 1e-320], ids=["shines away", "hardly shines"])
def test_a_file_whose_lights_miss_the_objects_has_the_default_ones(library: Library, intensity: float) -> None:
    room = Room().without("Bulb", "Sun")
    way = [1, 0, 0, 0] if intensity == 500 else [-(0.5**0.5), 0, 0, 0.5**0.5]
    room.light({"type": "spot", "intensity": intensity}, name="Spot", translation=[0, 3, 0], rotation=way)
    spec = job(library, room.glb, change=["Ball"])
    assert spec.scene.lights == Scene.model_fields["lights"].default
    said = spec.scene.source.left_out()  # type: ignore[union-attr]
    assert said[-1] == "its lights: none shines where the objects are, so the default lights do"


def changed(**changes: Any) -> bytes:
    """The room with other properties of nodes by name, or of the tree by "tree"."""
    room = Room()
    for entry in room.writer.tree["nodes"]:
        entry.update(changes.get(entry.get("name"), {}))
    room.writer.tree |= changes.get("tree", {})
    return room.glb


def crowded() -> bytes:
    room = Room()
    for k in range(30):
        room.node(name=f"Ball.{k:03}", mesh=room.ball, translation=[0, 0.5, -k])
    return room.glb


def deep(levels: int) -> bytes:
    room = Room()
    node = room.child(mesh=room.ball)
    for _ in range(levels - 2):
        node = room.child(children=[node])
    room.node(name="Deep", children=[node])
    return room.glb


REFUSED = {
    "unknown node": (
        changed(),
        {"change": ["Bal"]},
        "change.0",
        "there is no node 'Bal' in the file; did you mean 'Ball' or 'Table'?",
    ),
    "node of a light": (changed(), {"change": ["Ball", "Sun"]}, "change.1", "nothing of the node 'Sun' can be drawn"),
    "unknown number": (
        changed(),
        {"change": ["#99"]},
        "change.0",
        "there is no node '#99' in the file; there are 'Floor', 'Ball'",
    ),
    "nothing": (changed(), {"change": []}, "change", "it names 0 nodes; from 1 to 16 may change"),
    "too many things": (
        crowded(),
        {},
        "change",
        "the file has 33 things, of which 16 may change; name some of 'Floor', 'Ball'",
    ),
    "too many named": (crowded(), {"change": ["Ball.*"]}, "change", "it names 30 nodes; from 1 to 16 may change"),
    "unknown camera": (
        changed(),
        {"camera": "Camara"},
        "camera",
        "perspective camera 'Camara'; did you mean 'Camera'?",
    ),
    "instances": (
        changed(Ball={"extensions": {"EXT_mesh_gpu_instancing": {"attributes": {}}}}),
        {},
        "file",
        "it is a mesh, but no scene: node 'Ball' has instances (EXT_mesh_gpu_instancing), which are not read",
    ),
    "a deep tree": (deep(65), {}, "file", "its nodes are 65 deep within each other; at most 64 are taken"),
    "a camera without a direction": (changed(Camera={"scale": [0, 0, 0]}), {}, "file", "is scaled to nothing"),
    "a light that is not there": (
        changed(Sun={"extensions": {"KHR_lights_punctual": {"light": 7}}}),
        {},
        "file",
        "refers to the light 7, which is not there",
    ),
    "a camera in a grain of a landscape": (
        changed(Floor={"scale": [1e4, 1, 1e4]}),
        {"change": ["Ball"]},
        "camera",
        "times as wide as its camera is far",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_input_is_one_sentence_about_a_field(library: Library, case: str) -> None:
    data, source, field, sentence = REFUSED[case]
    error = refused(library, data, **source)
    assert error.field == f"scene.source.{field}"
    assert sentence in error.detail
    assert len(error.every) == 1


def test_a_tree_of_sixty_four_levels_is_read(library: Library) -> None:
    assert job(library, deep(64), change=["Deep"]).scene.objects


def elsewhere(uri: str) -> bytes:
    """The room's JSON, whose buffer is in another file."""
    glb = Room().glb
    tree = json.loads(glb[20 : 20 + struct.unpack_from("<I", glb, 12)[0]])
    tree["buffers"][0]["uri"] = uri
    return json.dumps(tree).encode().ljust(len(glb))  # as long as what it declares


UNREADABLE = {
    "a cycle": (changed(Ball={"children": [1]}), "its nodes are not a tree"),
    "not a number": (changed(Ball={"translation": [float("nan"), 0, 0]}), "nodes[1].translation is nan where a finite"),
    "the web": (elsewhere("http://a.b/c.bin"), "buffers[0] is in the file 'http://a.b/c.bin', which was not sent"),
    "another folder": (elsewhere("/etc/passwd"), "buffers[0] is in the file '/etc/passwd', which was not sent"),
    "a folder above": (elsewhere("../../c.bin"), "buffers[0] is in the file '../../c.bin', which was not sent"),
}


@pytest.mark.parametrize("case", UNREADABLE)
def test_a_file_that_is_no_mesh_is_not_added(library: Library, case: str) -> None:
    data, sentence = UNREADABLE[case]
    with pytest.raises(InvalidRequest, match="file: ") as caught:
        library.add_mesh(data, "gltf" if data.startswith(b"{") else "glb")
    assert sentence in caught.value.detail
    assert not library.entries(category="upload")


def test_a_camera_that_sees_nothing_is_refused_by_the_scene(library: Library) -> None:
    away = changed(Camera={"rotation": [0, 1, 0, 0]})
    why = (
        r"scene\.objects\.0: out of view: nothing of it is inside the frame.* node #1 of the file, and `source\.change`"
    )
    with pytest.raises(InvalidRequest, match=why):
        resolve(job(library, away, change=["Ball"]).scene, library)


def test_poses_and_targets_that_are_not_drawn_are_said(library: Library) -> None:
    unread = ["KHR_lights_punctual", "KHR_materials_sheen"]
    skins = {"skins": [{"joints": [0]}], "animations": [{}], "extensionsUsed": unread}
    data = changed(Ball={"skin": 0}, tree=skins)
    left_out = job(library, data, change=["Ball"]).scene.source.left_out()  # type: ignore[union-attr]
    pose = "the pose of 'Ball': it is drawn as it was before its skeleton bends it"
    assert left_out == (pose, "animations", "extension KHR_materials_sheen")


@pytest.mark.parametrize("uri", ["http://a.b/wood.png", "/etc/wood.png", "../../wood.png"])
def test_a_texture_that_is_elsewhere_is_not_looked_for_and_is_said(library: Library, uri: str) -> None:
    room = Room()
    tree = room.writer.tree
    tree |= {"images": [{"uri": uri}], "textures": [{"source": 0}]}
    tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    [phrase] = job(library, room.glb, change=["Ball"]).scene.source.left_out()  # type: ignore[union-attr]
    assert phrase == f"texture {uri} missing"


def test_hostile_names_are_lines_without_control_characters(library: Library) -> None:
    data = changed(Ball={"name": "a\x1b[2J\nb\u202e" + "x" * 500}, Lamp={"name": 5})
    spec = job(library, data, change=["#1", "#3"])
    titles = library.titles(thing.mesh for thing in spec.scene.objects)
    assert list(titles.values()) == ["a\ufffd[2J b\ufffd" + "x" * 92]
    assert len(refused(library, data, change=["y" * 200]).detail) < 500


def test_an_upload_of_somebody_else_is_unknown(library: Library) -> None:
    name = library.add_mesh(Room().glb, "glb").name
    given = {"scene": {"source": {"format": "file", "file": name}}}
    with pytest.raises(InvalidRequest, match=r"scene\.source\.file: there is no mesh"):
        parse(given, names_in(library, may_use=lambda _: False))
    with pytest.raises(InvalidRequest, match=r"scene\.source\.file: there is no upload"):
        parse(given, {"scene": names_in(library, may_use=lambda _: False)["scene"]})


def test_a_file_that_holds_no_scene_and_a_node_that_is_not_there_are_named(library: Library) -> None:
    obj = library.add_mesh(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "obj").name
    with pytest.raises(InvalidRequest, match=r"scene\.source\.file: a obj file holds no scene; glb and gltf files do"):
        parse({"scene": {"source": {"format": "file", "file": obj}}}, names_in(library))
    room = library.add_mesh(Room().glb, "glb").name
    for node in ("#99", "#6", "#!99", "#x"):
        with pytest.raises(InvalidRequest, match=r"scene\.objects\.0\.mesh: there is no"):
            parse({"scene": {"objects": [{"mesh": room + node}]}}, names_in(library))
    with pytest.raises(InvalidRequest, match=r"scene\.source\.file: it is read where a request is sent"):
        parse({"scene": {"source": {"format": "file", "file": room}}})


def test_what_is_fixed_has_all_parts_that_no_object_has(library: Library) -> None:
    spec = job(library, Room().glb, change=["Ball", "Lamp"])
    whole = library.mesh(upload_of(spec.scene.objects[0].mesh))
    meshes = [library.mesh(thing.mesh) for thing in (*spec.scene.objects, *spec.scene.fixed)]
    assert sum(mesh.triangles for mesh in meshes) == whole.triangles
    assert len({mesh.sha256 for mesh in (*meshes, whole)}) == 4


def test_a_campaign_has_scenes_of_files_and_holds_them(library: Library) -> None:
    name = library.add_mesh(Room().glb, "glb").name
    scenes = [{"source": {"format": "file", "file": name, "change": [node]}} for node in ("Ball", "Lamp")]
    attacks = [{"name": "a", "attack": {"renderer": "pyrender"}}]
    campaign = parse_campaign({"grids": [{"scenes": scenes, "attacks": attacks}]}, names_in(library))
    members = [member.scene.objects[0].mesh for member in campaign.grids[0].members()]
    assert members == [f"{name}#1", f"{name}#3"]
    assert uploads_in(campaign) == {name: "grids.0.scenes.0.objects.0.mesh"}
    assert parse_campaign(campaign.model_dump(mode="json")) == campaign


def test_a_scene_object_of_python_says_where_its_file_is_read() -> None:
    with pytest.raises(ValueError, match="it is read where a request is sent; give the scene as data there"):
        Scene(source={"format": "file", "file": "./room.glb"})  # type: ignore[call-arg, arg-type]
