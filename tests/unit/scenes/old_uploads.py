"""Writes an upload under a name that today's parser would not give it, as an earlier parser's uploads have."""

import hashlib
import json
from pathlib import Path

from scene_attack.scenes.reading.formats import read_mesh
from scene_attack.scenes.store import save_parts


def add_as_before(directory: Path, data: bytes, kind: str) -> str:
    """Stores a mesh by the SHA-256 of its bytes alone. Returns the name by which scenes call it."""
    sha256 = hashlib.sha256(data).hexdigest()
    directory.mkdir(parents=True, exist_ok=True)
    (directory / sha256).write_bytes(data)
    parts = read_mesh(data, kind, 100_000)
    save_parts(directory / f"{sha256}.npz", parts)
    record = {
        "sha256": sha256,
        "kind": kind,
        "parser": 0,
        "mesh_sha256": hashlib.sha256((directory / f"{sha256}.npz").read_bytes()).hexdigest(),
        "size": len(data),
        "triangles": sum(len(part.faces) for part in parts),
    }
    (directory / f"{sha256}.json").write_text(json.dumps(record))
    return f"sha256:{sha256}"
