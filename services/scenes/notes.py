"""Finds what a mesh file names in other files, which are never read."""

import re

_NAMES = {"obj": rb"^[ \t]*mtllib[ \t]+([^\r\n]+)", "ply": rb"^comment TextureFile[ \t]+([^\r\n]+)"}
_MAX_NAMES = 5


def missing_files(data: bytes, kind: str) -> tuple[str, ...]:
    """Returns sentences about the materials and textures that the mesh lacks because they are in other files."""
    if kind not in _NAMES:
        return ()
    found: dict[str, None] = {}
    for match in re.finditer(_NAMES[kind], data, re.MULTILINE):
        found[match[1].strip()[:200].decode("utf-8", "replace")] = None
        if len(found) == _MAX_NAMES:
            break
    return tuple(
        f"Its materials and textures are in {name}, which is not read: it is shown without. A glb holds its own."
        for name in found
    )
