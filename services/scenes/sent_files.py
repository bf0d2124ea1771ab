"""From the files that somebody sends to the mesh among them."""

import posixpath
from collections.abc import Sequence

from services.errors import InvalidRequest
from services.scenes.about import About
from services.scenes.archive import SIGNATURE
from services.scenes.bundle import Bundle, bundle_of, clean_name
from services.scenes.isolated_reading import reader


def to_bundle(sent: Sequence[tuple[str, bytes]], kind: str | None, mesh: str | None, about: About, most: int) -> Bundle:
    """Returns the mesh in files with their names, or in one zip file, which is unpacked in a confined process.

    `kind` is the format of the mesh, or None to take it from its name; `mesh` names it among several. A zip file may
    unpack to `most` bytes. Raises InvalidRequest("file", "kind" or "mesh", …), and JobFailure("internal").
    """
    (name, data), *others = sent
    if others:
        files: dict[str, bytes] = {}
        for name, data in sent:
            if (path := clean_name(name)) in files:
                raise InvalidRequest("file", f"two files are called {path!r}")
            files[path] = data
    elif data.startswith(SIGNATURE) and kind != "3mf" and not name.lower().endswith(".3mf"):
        files = reader().unpack(data, most)
    elif kind is not None:  # its name says nothing then
        return Bundle(kind, data, {}, about)
    else:
        files = {posixpath.basename(name): data}
    return bundle_of(files, kind, mesh, about)
