"""The files beside a mesh file, as its parser finds them: by the names in the file, and never anything else."""

import posixpath
from collections.abc import Iterable, Mapping
from functools import cached_property
from io import BytesIO
from typing import Any
from urllib.parse import unquote

import trimesh

from services.errors import InvalidRequest
from services.scenes.image_file import open_texture
from services.scenes.named import Named
from services.scenes.references import named_files, texture_name
from services.scenes.text import decoded
from services.scenes.unreadable import DAMAGED, Unreadable

IMAGES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".gif", ".tga")


class Beside(trimesh.resolvers.Resolver):  # type: ignore[misc]  # trimesh has no types
    """Gives a parser the files beside a mesh and refuses every other name and address.

    A texture is given only if it is an image of a known format; it raises InvalidRequest("file", …) otherwise.
    """

    def __init__(self, files: Mapping[str, bytes], kind: str = "", data: bytes = b"") -> None:
        """`files` by their paths relative to the folder of the mesh, which is `data` of format `kind`."""
        self._files = files
        self.paths = tuple(files)
        self.size = sum(map(len, files.values()))
        self.named = self._named(data, kind)
        """What the mesh and its material libraries name, in their order."""

    def find(self, name: str) -> str | None:
        """Returns the path of the file that a mesh calls `name`; None if it is not there.

        Exporters write any case, backslashes, escapes, and paths of their own machines: a file of the same name in any
        folder is the file if no other has that name.
        """
        for written in (name, unquote(name)):
            path = posixpath.normpath(written.strip().replace("\\", "/")).lower()
            if path in self._paths:
                return self._paths[path]
            same = [one for lower, one in self._paths.items() if posixpath.basename(lower) == posixpath.basename(path)]
            if len(same) == 1:
                return same[0]
        return None

    def get(self, key: str) -> bytes:
        """Returns the file that a mesh calls `key`. Raises FileNotFoundError."""
        if (path := self.find(key) or self.find(texture_name(key)[1])) is None:
            raise FileNotFoundError(key)
        if path in self._libraries:
            return self.libraries().encode()  # the parser asks for the first only
        return self._images[path] if path in self._images else self._files[path]

    def data(self, path: str) -> bytes:
        """Returns the bytes of the file at a path that `find` has returned."""
        return self._files[path]

    def check(self) -> None:
        """Raises InvalidRequest("file", …) for a texture that is shown and is no image."""
        for path in filter(None, (self.find(one.name) for one in self.named if one.what == "texture")):
            if path.lower().endswith(IMAGES):
                self._images[path] = _checked(self._files[path], path)

    def keys(self) -> Iterable[str]:
        """The paths of the files."""
        return self._files.keys()

    def write(self, name: str, data: Any) -> None:
        """Is refused."""
        raise NotImplementedError

    def namespaced(self, namespace: str) -> "Beside":
        """Is refused."""
        raise FileNotFoundError(namespace)

    @cached_property
    def _paths(self) -> dict[str, str]:
        return {posixpath.normpath(path).lower(): path for path in self._files}

    @cached_property
    def _images(self) -> dict[str, bytes]:
        return {}

    @cached_property
    def _libraries(self) -> list[str]:
        found = (self.find(one.name) for one in self.named if one.what == "material library")
        return list(dict.fromkeys(path for path in found if path))

    def _named(self, data: bytes, kind: str) -> list[Named]:
        direct = named_files(data, kind)
        libraries = [self.find(one.name) for one in direct if one.what == "material library"]
        inside = [one for path in dict.fromkeys(libraries) if path for one in named_files(self._files[path], "mtl")]
        return list(dict.fromkeys([*direct, *inside]))

    def libraries(self) -> str:
        """The text of the material libraries that the mesh names and that are there."""
        return "\n".join(decoded(self._files[path]) for path in self._libraries)


def _checked(data: bytes, path: str) -> bytes:
    try:
        image = open_texture(data, path)
        if image.format in ("PNG", "JPEG", "WEBP"):
            return data
        buffer = BytesIO()
        image.convert("RGBA").save(buffer, "PNG")
        return buffer.getvalue()
    except (ValueError, OSError, SyntaxError) as error:
        said = error if isinstance(error, Unreadable) else DAMAGED
        raise InvalidRequest("file", f"the texture {path} cannot be read: {said}") from error
