"""Writes uploads as scene-attack 0.1 stored them: named by their bytes alone, without the parsed mesh."""

import hashlib
import json
from pathlib import Path


def add_as_before(directory: Path, data: bytes, kind: str) -> str:
    """Stores a file, and returns the name by which scenes called it."""
    sha256 = hashlib.sha256(data).hexdigest()
    directory.mkdir(parents=True, exist_ok=True)
    (directory / sha256).write_bytes(data)
    record = {"sha256": sha256, "kind": kind, "size": len(data), "triangles": 12}
    (directory / f"{sha256}.json").write_text(json.dumps(record))
    return f"sha256:{sha256}"
