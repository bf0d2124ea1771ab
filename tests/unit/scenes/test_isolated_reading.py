"""Uploads are read in processes of their own: what they answer, how they end, and what the parent believes of them."""

import json
import os
import socket
import threading

import numpy as np
import psutil
import pytest
from safetensors.numpy import load, save

from benchmarks.gltf_models import MODELS
from scene_attack.errors import InvalidRequest
from scene_attack.scenes.mesh import Part
from scene_attack.scenes.reading import process
from scene_attack.scenes.reading.formats import read_mesh
from scene_attack.scenes.reading.isolated import IsolatedReader, Report, pack, reader, unpack
from tests.processes import command_line
from tests.unit.scenes.mesh_files import BOXES, MAX_FACES, same
from tests.unit.scenes.scene_files import Room
from tests.unit.scenes.test_image_file import POSTSCRIPT, stored

pytestmark = pytest.mark.slow

FILES = {kind: (kind, data) for kind, data in BOXES.items()} | {name: ("glb", make()) for name, make in MODELS.items()}


def servers() -> list[psutil.Process]:
    """The living servers among this process's children."""
    return [p for p in psutil.Process().children() if "scene_attack.scenes.reading.process" in command_line(p)]


def own_server() -> psutil.Process:
    (server,) = servers()
    return server


@pytest.mark.parametrize("name", FILES)
def test_a_file_is_read_as_it_is_in_this_process(name):
    kind, data = FILES[name]
    parts, _ = reader().read_mesh(data, kind, MAX_FACES)
    expected = read_mesh(data, kind, MAX_FACES)
    assert len(parts) == len(expected)
    assert all(same(one, other) for one, other in zip(parts, expected, strict=True))


@pytest.mark.parametrize(
    ("data", "kind", "field", "word"),
    [
        (BOXES["obj"], "fbx", "kind", "obj, ply, stl, glb, off"),
        (BOXES["glb"][:-9], "glb", "file", "complete"),
    ],
)
def test_a_file_is_refused_as_it_is_in_this_process(data, kind, field, word):
    with pytest.raises(InvalidRequest, match=word) as error:
        reader().read_mesh(data, kind, MAX_FACES)
    assert error.value.field == field


def test_an_image_is_read_and_its_size_is_checked():
    image = reader().read_image(stored("PNG"), (5, 7))
    assert image.tolist() == np.arange(105).reshape(5, 7, 3).tolist()
    with pytest.raises(InvalidRequest, match="image: it has 7×5 pixels; the camera of the scene has 5×7"):
        reader().read_image(stored("PNG"), (7, 5))
    with pytest.raises(InvalidRequest, match="not a PNG, JPEG or WebP"):
        reader().read_image(POSTSCRIPT, (8, 8))


def test_no_child_is_left_and_files_are_read_at_the_same_time():
    threads = [threading.Thread(target=reader().read_mesh, args=(BOXES["obj"], "obj", MAX_FACES)) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    reader().read_mesh(BOXES["obj"], "obj", MAX_FACES)
    _, living = psutil.wait_procs(own_server().children(), timeout=60)  # the last may still be ending
    assert living == []


def test_a_server_that_was_killed_is_started_again():
    reader().start()
    server = own_server()
    server.kill()
    server.wait()
    assert reader().read_mesh(BOXES["stl"], "stl", MAX_FACES)[0]


def test_the_server_ends_with_its_reader():
    mine = IsolatedReader()
    mine.start()
    processes = servers()
    mine.close()
    assert sum(not p.is_running() for p in processes) == 1


def test_a_server_has_no_environment_of_ours_and_no_rights():
    reader().start()
    server = own_server()
    assert set(server.environ()) == {"PYTHONPATH", "PYTHONUTF8", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"}
    if os.geteuid() == 0:
        assert 0 not in server.uids() + server.gids()
    with open(f"/proc/{server.pid}/status") as file:
        assert "NoNewPrivs:\t1" in file.read()


def test_a_file_that_needs_too_much_memory_is_refused(monkeypatch):
    monkeypatch.setattr(process, "read_mesh", lambda *_: bytearray(2**40))
    ours, theirs = socket.socketpair()
    with ours, theirs:
        ours.sendall(b'{"mesh": "obj", "max_faces": 1, "files": [], "up": null}\nv')
        ours.shutdown(socket.SHUT_WR)
        process.answer(theirs.fileno())
        assert b'"field": "file", "detail": "it needs more memory' in ours.recv(1000)


@pytest.mark.parametrize("ends", ["at once", "with an error", "half-way"])
def test_a_child_that_ends_without_an_answer_is_the_files_fault(monkeypatch, ends):
    mine, child = IsolatedReader(), {}

    def hand_over(end):
        copy = end.dup()
        child["thread"] = threading.Thread(target=die, args=(copy,))
        child["thread"].start()

    def die(end):
        if ends == "half-way":
            end.sendall(b'{"fie')
        elif ends == "with an error":
            end.sendall(b"[]\n")
        end.close()

    monkeypatch.setattr(mine, "_hand_over", hand_over)
    with pytest.raises(InvalidRequest, match="could not be read within the time and the memory"):
        mine.read_mesh(bytes(2**20), "obj", MAX_FACES)
    child["thread"].join()


def test_a_child_over_its_time_is_killed(monkeypatch):
    monkeypatch.setattr(process, "WALL_SECONDS", 0.05)
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    pid = os.fork()
    if not pid:
        # A child that waits for its request for ever; the limits of a child would be those of the test.
        ours.close()
        monkeypatch.setattr(process, "confine", lambda *_: None)
        process.serve(theirs, 0)
        os._exit(0)
    theirs.close()
    request, kept = socket.socketpair()
    kept.settimeout(60)
    with ours, kept:
        with request:
            socket.send_fds(ours, [b"+"], [request.fileno()])
        assert kept.recv(1) == b"", "the child has ended, and its end of the connection with it"
    assert os.waitpid(pid, 0)[1] == 0


def damaged(change):
    """A packed mesh after `change` has edited its arrays."""
    arrays = load(pack(read_mesh(MODELS["two UV sets"](), "glb", MAX_FACES), Report()))
    change(arrays)
    return save(arrays)


def replaced(name, value):
    return lambda arrays: arrays.update({name: value(arrays[name])})


def document(old, new):
    def change(arrays):
        text = arrays["document"].tobytes()
        assert old in text
        arrays["document"] = np.frombuffer(text.replace(old, new, 1), np.uint8)

    return change


FIRST_MAP = "0.metallic_roughness.base_color"
LIES = {
    "not finite": replaced("0.vertices", lambda a: np.where(a == a[0, 0], np.float32(np.nan), a)),
    "beyond the frame": replaced("0.vertices", lambda a: a * np.float32(2)),
    "long normals": replaced("0.normals", lambda a: a * np.float32(2)),
    "another type": replaced("0.vertices", lambda a: a.astype(np.float64)),
    "another shape": replaced("0.vertices", lambda a: a[:, :2].copy()),
    "fewer normals": replaced("0.normals", lambda a: a[1:]),
    "no faces": replaced("0.faces", lambda a: a[:0]),
    "a vertex that is not there": replaced("0.faces", lambda a: a + np.int32(1)),
    "a negative vertex": replaced("0.faces", lambda a: a - np.int32(1)),
    "more vertices than corners": replaced("0.faces", lambda a: a[:1]),
    "a colour beyond 1": replaced("0.color", lambda a: a * np.float32(3)),
    "a tangent less": replaced("0.metallic_roughness.tangents", lambda a: a[1:]),
    "a texture without colours": replaced(FIRST_MAP, lambda a: a[..., :3].copy()),
    "an array less": lambda arrays: arrays.pop("0.faces"),
    "a part more": lambda arrays: arrays.update({"1.uv": arrays["0.uv"]}),
    "a part that is not there": document(b'"parts":1', b'"parts":2'),
    "no document": lambda arrays: arrays.pop("document"),
    "metallic beyond 1": document(b'"metallic":', b'"metallic":7e'),
    "a field more": document(b'"parts":', b'"pickle":1,"parts":'),
    "another alpha mode": document(b"OPAQUE", b"GLASS"),
    "a texture that is not there": lambda arrays: arrays.pop(FIRST_MAP),
    "another texture's wrap": document(b"10497", b"10498"),
}


def of_scene(**changes):
    """The packed mesh of a room with its scene, after changes of the scene's own JSON."""
    scenes = []
    parts = read_mesh(Room().glb, "glb", MAX_FACES, tell=scenes.append)
    arrays = load(pack(parts, Report(scene=scenes[0])))
    document = json.loads(arrays["document"].tobytes())
    document["scene"] |= changes
    return save(arrays | {"document": np.frombuffer(json.dumps(document).encode(), np.uint8)})


def test_a_scene_comes_with_its_mesh():
    parts, about = unpack(of_scene(), MAX_FACES)
    assert [about.scene.nodes[k].name for k in about.scene.parts] == ["Floor", "Ball", "Lamp"]
    assert len(parts) == 3


@pytest.mark.parametrize(
    "changes",
    [
        {"parts": [0]},
        {"parts": [0, 1, 99]},
        {"nodes": [{"name": "a", "parent": 0, "triangles": 2, "extent": None}]},
        {"nodes": [{"name": "a" * 101, "parent": None, "triangles": 2, "extent": None}]},
        {"extent": {"centre": [0, 0, 0], "size": [1, 1, 1], "radius": 0}},
        {"cameras": [{"position": [0, 0, 0]}]},
        {"pickle": 1},
    ],
    ids=lambda changes: str(changes)[:40],
)
def test_a_scene_that_is_none_is_not_believed(changes):
    with pytest.raises(ValueError):  # noqa: PT011 - of many messages
        unpack(of_scene(**changes), MAX_FACES)


def test_what_is_packed_is_unpacked():
    parts = read_mesh(MODELS["two UV sets"](), "glb", MAX_FACES)
    found, notes = unpack(damaged(lambda _: None), MAX_FACES)
    assert notes == Report()
    assert all(isinstance(one, Part) and same(one, other) for one, other in zip(found, parts, strict=True))


@pytest.mark.parametrize("lie", LIES)
def test_an_answer_that_is_no_mesh_is_not_believed(lie):
    with pytest.raises(ValueError):  # noqa: PT011 - of many messages
        unpack(damaged(LIES[lie]), MAX_FACES)


def test_an_answer_with_too_many_triangles_is_not_believed():
    data = pack(read_mesh(BOXES["obj"], "obj", MAX_FACES), Report())
    unpack(data, 12)
    with pytest.raises(ValueError, match="more than 11 triangles"):
        unpack(data, 11)


@pytest.mark.parametrize("data", [b"", b"\0" * 8, b"\xff" * 100, b"\x80\x04\x95."])
def test_bytes_that_are_no_arrays_are_not_believed(data):
    with pytest.raises(ValueError, match="no safetensors file"):
        unpack(data, MAX_FACES)


def test_a_texture_of_several_parts_is_sent_once():
    (part,) = read_mesh(MODELS["two UV sets"](), "glb", MAX_FACES)
    one, three = len(pack((part,), Report())), len(pack((part,) * 3, Report()))
    texels = sum(texture.texels.nbytes for texture in part.metallic_roughness.maps.values())
    assert three < 3 * one - texels
    found, _ = unpack(pack((part,) * 3, Report()), MAX_FACES)
    name = next(iter(part.metallic_roughness.maps))
    assert found[0].metallic_roughness.maps[name].texels is found[2].metallic_roughness.maps[name].texels
