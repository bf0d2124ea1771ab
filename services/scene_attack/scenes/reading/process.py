"""The process in which files that are not trusted are parsed: a server that forks one confined child for each file.

`scene_attack.scenes.reading.isolated` starts it with `python -m scene_attack.scenes.reading.process FD`, FD being its
end of a socket. For each file it gets a descriptor over that socket, from which the child reads the request and to
which it writes the answer: a line of JSON, and bytes after it. The server itself reads no byte of any file. It has
imported all that a child needs, so that a child begins within milliseconds and needs no file.
"""

import base64
import gc
import json
import os
import selectors
import signal
import socket
import sys
import time
import traceback
from contextlib import suppress
from io import BytesIO
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from scene_attack.confinement import Limits, address_space, confine, drop_privileges
from scene_attack.errors import InvalidRequest
from scene_attack.extras import MissingExtra
from scene_attack.scenes.bundle import Bundle, unpack_archive
from scene_attack.scenes.environment import read_map
from scene_attack.scenes.image_file import read_image
from scene_attack.scenes.reading.companion_files import CompanionFiles
from scene_attack.scenes.reading.formats import KINDS, check_packages, read_mesh, report
from scene_attack.scenes.reading.isolated import FILE_BYTES, pack
from scene_attack.scenes.scene_file import SceneFile

LIMITS = Limits(memory_bytes=FILE_BYTES, cpu_seconds=25)
WALL_SECONDS = 90.0
"""Longest life of a child, after which the server kills it. A busy machine may give it a third of a processor."""

SMALL_EXR = (
    "di8xAQIAAABjaGFubmVscwBjaGxpc3QANwAAAEIAAgAAAAAAAAABAAAAAQAAAEcAAgAAAAAAAAABAAAAAQAAAFIAAgAAAAAAAAABAAAAAQAA"
    "AABjb21wcmVzc2lvbgBjb21wcmVzc2lvbgABAAAAA2RhdGFXaW5kb3cAYm94MmkAEAAAAAAAAAAAAAAAAQAAAAAAAABkaXNwbGF5V2luZG93"
    "AGJveDJpABAAAAAAAAAAAAAAAAEAAAAAAAAAbGluZU9yZGVyAGxpbmVPcmRlcgABAAAAAHBpeGVsQXNwZWN0UmF0aW8AZmxvYXQABAAAAAAA"
    "gD9zY3JlZW5XaW5kb3dDZW50ZXIAdjJmAAgAAAAAAAAAAAAAAHNjcmVlbldpbmRvd1dpZHRoAGZsb2F0AAQAAAAAAIA/dHlwZQBzdHJpbmcA"
    "DQAAAHNjYW5saW5laW1hZ2UAXgEAAAAAAAAAAAAAGAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA=="
)
"""A black map of two texels."""


def main() -> None:
    """Warms up, gives up all rights, says that it is ready, and then serves until its parent ends."""
    control = socket.socket(fileno=int(sys.argv[1]))
    _warm_up()
    base = address_space()
    missing = drop_privileges() + _trial(base)
    control.send(json.dumps({"missing": missing}).encode())
    gc.collect()
    gc.freeze()  # a collection in a child would copy every page that it looks at
    serve(control, base)


def serve(control: socket.socket, base: int) -> None:
    """Forks a child for each descriptor that comes, and ends a child that takes too long."""
    selector = selectors.DefaultSelector()
    running: dict[int, tuple[int, float]] = {}  # pidfd -> process id, when to end it
    selector.register(control, selectors.EVENT_READ)
    while True:
        wait = min((end - time.monotonic() for _, end in running.values()), default=None)
        for key, _ in selector.select(wait if wait is None else max(wait, 0.0)):
            if key.fd in running:
                os.waitpid(running.pop(key.fd)[0], 0)
                selector.unregister(key.fd)
                os.close(key.fd)
                continue
            message, descriptors, _, _ = socket.recv_fds(control, 1, 1)
            if not message:  # the parent has ended, or wants no more
                for pid, _ in running.values():
                    os.kill(pid, signal.SIGKILL)
                return
            child = _fork(descriptors[0], base)
            os.close(descriptors[0])
            handle = os.pidfd_open(child)
            running[handle] = child, time.monotonic() + WALL_SECONDS
            selector.register(handle, selectors.EVENT_READ)
        for pid, end in running.values():
            if end <= time.monotonic():
                os.kill(pid, signal.SIGKILL)


def _fork(descriptor: int, base: int) -> int:
    pid = os.fork()
    if pid:
        return pid
    try:
        os.dup2(descriptor, 3)
        os.closerange(4, 1024)
        confine(LIMITS, base)
        answer(3)
    except Exception:
        traceback.print_exc()
    finally:
        os._exit(0)


def answer(descriptor: int) -> None:
    """Reads a request to its end and answers it."""
    pieces = []
    while piece := os.read(descriptor, 2**20):
        pieces.append(piece)
    head, _, data = b"".join(pieces).partition(b"\n")
    try:
        reply, payload = read(json.loads(head), data)
    except InvalidRequest as error:
        reply, payload = {"field": error.field, "detail": error.detail}, b""
    except MemoryError:
        reply, payload = {"field": "file", "detail": "it needs more memory than reading a file may take"}, b""
    view = memoryview(json.dumps(reply).encode() + b"\n" + payload)
    while view:
        view = view[os.write(descriptor, view) :]


def read(request: dict[str, Any], data: bytes) -> tuple[dict[str, Any], bytes]:
    """Answers {"mesh": kind, "max_faces": n, "up": axis, "files": [[name, length], …]} by the packed parts,
    {"map": kind} by its texels, {"archive": most} by the files of a zip file, and {"image": [height, width]} by its RGB
    bytes.

    The bytes of a mesh follow those of its files. Raises InvalidRequest.
    """
    if "mesh" in request:
        kind, start = request["mesh"], 0
        others: dict[str, bytes] = {}
        for name, length in request["files"]:
            others[name] = data[start : start + length]
            start += length
        data = data[start:]
        files = CompanionFiles(others, kind, data)
        notes: list[str] = []
        scenes: list[SceneFile] = []
        parts = read_mesh(data, kind, request["max_faces"], files, request["up"], notes.append, scenes.append)
        return {}, pack(parts, report(data, kind, files, parts, notes, scenes[0] if scenes else None))
    if "map" in request:
        texels = read_map(data, request["map"])
        return {"size": texels.shape[:2]}, texels.tobytes()
    if "archive" in request:
        files_of = unpack_archive(data, request["archive"])
        return {"files": [[name, len(content)] for name, content in files_of.items()]}, b"".join(files_of.values())
    if "image" in request:
        height, width = request["image"]
        return {}, read_image(data, (height, width)).tobytes()
    raise ValueError(f"there is no request {request}")


def _warm_up() -> None:
    """Reads a file of every kind once: parsers import modules when they are first needed."""
    box = trimesh.creation.box()
    for kind in KINDS:
        with suppress(MissingExtra):
            check_packages(kind)
            read({"mesh": kind, "max_faces": 12, "files": [], "up": None}, exported(box, kind))
    for kind in ("PNG", "JPEG", "WEBP"):
        file = BytesIO()
        Image.fromarray(np.zeros((2, 2, 3), np.uint8)).save(file, kind)
        read({"image": (2, 2)}, file.getvalue())
    read({"map": "hdr"}, b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n" + bytes(4))
    with suppress(MissingExtra):
        read({"map": "exr"}, base64.b64decode(SMALL_EXR))
    read({"archive": 2**20}, Bundle("obj", b"", {"a.mtl": b""}).stored())


def exported(mesh: trimesh.Trimesh, kind: str) -> bytes:
    """Returns a mesh as a file of a kind; a gltf holds its buffers."""
    if kind == "gltf":
        files = trimesh.exchange.gltf.export_gltf(trimesh.Scene(mesh), embed_buffers=True)
        return bytes(files["model.gltf"])
    data = mesh.export(file_type=kind)
    return data.encode() if isinstance(data, str) else bytes(data)


def _trial(base: int) -> list[str]:
    """Returns a phrase for each right that a child could not be refused."""
    ours, theirs = os.pipe()
    pid = os.fork()
    if not pid:
        try:
            os.write(theirs, json.dumps(confine(LIMITS, base)).encode())
        finally:
            os._exit(0)
    os.close(theirs)
    with os.fdopen(ours) as pipe:
        missing: list[str] = json.load(pipe)
    os.waitpid(pid, 0)
    return missing


if __name__ == "__main__":
    main()
