"""Uploads: a mesh file with the files that it was sent with and its sender's statements; unpacks zip files.

Archives are not trusted: they are unpacked in memory, by a confined process (`scene_attack.scenes.reading.process`).
"""

import hashlib
import json
import posixpath
import re
import stat
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from pathlib import PurePath
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from scene_attack.errors import InvalidRequest
from scene_attack.text import line, visible

LONGEST_TITLE = 100
Up = Literal["y", "z"]
Title = Annotated[
    str,
    Field(min_length=1, max_length=LONGEST_TITLE, description="the name that people see beside the hash"),
    AfterValidator(line),
]
Licence = Annotated[
    str,
    Field(min_length=1, max_length=100, description="the licence that it may be used under"),
    AfterValidator(line),
]
Credit = Annotated[
    str,
    Field(min_length=1, max_length=500, description="whom to name wherever it is shown"),
    AfterValidator(line),
]


def title_of(file: PurePath) -> str:
    """The name that an upload has from its file's, if its sender says none; "" if nothing of that is left."""
    return visible(file.stem)[:LONGEST_TITLE]


class About(BaseModel):
    """The sender's statements about an upload. They are stored with it and part of its hash; none is guessed.

    up: the axis of the file that points up; None: as its format says.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    # What is stored is read as it is: it was checked when it was sent, by the rules of its time.
    title: str | None = None
    up: Up | None = None
    licence: str | None = None
    credit: str | None = None

    def digest_part(self) -> str:
        """The text that the hash of an upload covers of this; empty if its sender states nothing."""
        fields = self.model_dump(exclude_none=True)
        return f" {json.dumps(fields, sort_keys=True)}" if fields else ""


NOTHING_SAID = About()


MESH_KINDS = ("obj", "ply", "stl", "glb", "off", "gltf", "dae", "3mf")
"""The kinds of mesh files, which are also the endings of their names."""
CONVERTED_KINDS = ("blend", "usd", "usda", "usdc", "usdz")
"""The endings of files that the command `convert` makes meshes of."""
MAP_KINDS = ("hdr", "exr")
"""The kinds of environment maps."""
_IMAGES = ("png", "jpg", "jpeg", "webp")
_TEXTURES = (*_IMAGES, "bmp", "gif", "tga")
BESIDE: Mapping[str, tuple[str, ...]] = {
    "obj": ("mtl", *_TEXTURES),
    "ply": _TEXTURES,
    "dae": _TEXTURES,
    "gltf": ("bin", *_IMAGES),
    "glb": ("bin", *_IMAGES),
}
"""The endings of files that a mesh of a kind may name. The other kinds hold all that they need."""
MAX_FILES = 500
"""Files of one upload."""
MAX_NAME = 255
PARSER = 2
"""Version of what reads uploads. Increase it with any change to the mesh that some file gives."""


@dataclass(frozen=True, eq=False)
class Bundle:
    """A mesh file of a kind, and the files that it may name, each by its path relative to the mesh's folder.

    about: what its sender says of it.
    """

    kind: str
    data: bytes
    others: Mapping[str, bytes]
    about: About = NOTHING_SAID

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return len(self.data) + sum(map(len, self.others.values()))

    @cached_property
    def sha256(self) -> str:
        """The upload's name, 64 hexadecimal digits: a hash of the kind, the parser, what is said of it, and all names
        and bytes."""
        digest = hashlib.sha256(f"{self.kind} {PARSER}{self.about.digest_part()}\n".encode())
        if self.others:
            digest.update(f"{len(self.others)} files beside {len(self.data)} bytes\n".encode())
        digest.update(self.data)
        for name, data in sorted(self.others.items()):
            digest.update(f"\n{json.dumps(name)} {len(data)}\n".encode())
            digest.update(data)
        return digest.hexdigest()

    def files(self) -> dict[str, bytes]:
        """The mesh, `mesh.<kind>`, and then the others, by relative paths none of which leads out of their folder."""
        above = max((name.split("/").count("..") for name in self.others), default=0)
        folder = "mesh/" * above
        named = ((f"mesh.{self.kind}", self.data), *sorted(self.others.items()))
        return {posixpath.normpath(folder + name): data for name, data in named}

    def stored(self) -> bytes:
        """The bytes that are kept: the mesh file itself, or a zip file of it and the others, always the same."""
        if not self.others:
            return self.data
        buffer = BytesIO()
        with zipfile.ZipFile(buffer, "w") as archive:
            for name, data in self.files().items():
                archive.writestr(zipfile.ZipInfo(name), data)
        return buffer.getvalue()


def bundle_of(
    files: Mapping[str, bytes], kind: str | None = None, mesh: str | None = None, about: About = NOTHING_SAID
) -> Bundle:
    """Returns the bundle of files by name (`clean_name`). `mesh` names the mesh among several, `kind` its format.

    Raises InvalidRequest("mesh", …) if there are several meshes and none is named, or the named one is not there, and
    InvalidRequest("file" or "kind", …) if there is none.
    """
    if kind is not None and kind not in (*MESH_KINDS, *MAP_KINDS):
        raise InvalidRequest("kind", f"{kind!r} is not read; one of {', '.join((*MESH_KINDS, *MAP_KINDS))} is")
    if kind is None and len(files) == 1 and _ending(only := next(iter(files))) in MAP_KINDS:
        return Bundle(_ending(only), files[only], {}, about)
    main = _main(list(files), kind, mesh)
    folder = posixpath.dirname(main)
    form = kind or _ending(main)
    endings = BESIDE.get(form, ())
    others = {
        posixpath.relpath(name, folder or "."): data
        for name, data in files.items()
        if name != main and _ending(name) in endings
    }
    return Bundle(form, files[main], others, about)


def clean_name(name: str) -> str:
    """Returns a file's name as a relative path with forward slashes.

    Raises InvalidRequest("file", …) for a name that points outside, is no text, or is too long.
    """
    path = name.replace("\\", "/")
    if not path.isprintable() or not path.strip("/. ") or len(path) > MAX_NAME:
        raise InvalidRequest("file", f"{name[:60]!r} is no name of a file: it is empty, too long or no text")
    if path.startswith("/") or re.match(r"[A-Za-z]:", path) or ".." in path.split("/"):
        raise InvalidRequest("file", f"{name!r} points outside; the names of files are relative and without `..`")
    return posixpath.normpath(path)


def _main(names: Sequence[str], kind: str | None, mesh: str | None) -> str:
    meshes = [name for name in names if _ending(name) in ((kind,) if kind else MESH_KINDS)]
    if mesh is not None:
        stated = mesh.replace("\\", "/")
        matches = [name for name in names if name == stated] or [
            name for name in names if posixpath.basename(name) == stated
        ]
        if len(matches) == 1 and (kind or matches[0] in meshes):
            return matches[0]
        if len(matches) > 1:
            raise InvalidRequest("mesh", f"there are {_listed(matches)}; say which by its whole path")
        raise InvalidRequest("mesh", f"there is no mesh {mesh!r} among the files{_there_are(meshes)}")
    if not meshes:
        endings = ", ".join(f".{ending}" for ending in ((kind,) if kind else MESH_KINDS))
        if len(names) == 1:
            hint = "; `scene-attack convert` makes a .glb file of it" if _ending(names[0]) in CONVERTED_KINDS else ""
            raise InvalidRequest("kind", f"the name {names[0]!r} does not say it; a mesh ends in {endings}{hint}")
        raise InvalidRequest("file", f"there is no mesh among the {len(names):,} files; a mesh ends in {endings}")
    if len(meshes) > 1:
        raise InvalidRequest(
            "mesh", f"there are {len(meshes)} meshes, {_listed(meshes)}: name one in the field `mesh` (--mesh)"
        )
    return meshes[0]


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(repr(name) for name in names[:5])
    return shown if len(names) <= 5 else f"{shown} and {len(names) - 5} more"


def _there_are(meshes: Sequence[str]) -> str:
    return f"; the meshes are {_listed(meshes)}" if meshes else ""


def _ending(name: str) -> str:
    return posixpath.splitext(name)[1].lower().removeprefix(".")


SIGNATURE = b"PK\x03\x04"
MAX_RATIO = 100
"""Largest ratio of the bytes that an archive holds to its own, beyond SMALL bytes. Text compresses to a tenth."""
SMALL = 2**20
_ENCRYPTED = 1
_IGNORED = ("__MACOSX/", ".DS_Store", "Thumbs.db")
"""Names of files and folders that file managers add to archives."""


def unpack_archive(data: bytes, most: int) -> dict[str, bytes]:
    """Returns the files of a zip file by name, which is a relative path.

    Raises InvalidRequest("file", …), which names the entry, for archives that are damaged or encrypted, with more than
    MAX_FILES entries or `most` bytes, that unpack to MAX_RATIO times their size, with links or special files, two
    files of a name, or a name that points outside.
    """
    try:
        with zipfile.ZipFile(BytesIO(data)) as archive:
            entries = _checked(archive.infolist(), len(data), most)
            return {name: archive.read(entry) for name, entry in entries.items()}
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError, OSError) as error:
        if isinstance(error, InvalidRequest):
            raise
        # Only the words of the zip reader itself are about the file.
        damage = f"damaged: {str(error)[:200]}" if isinstance(error, zipfile.BadZipFile) else "damaged, or cut off"
        raise InvalidRequest("file", f"the zip file is {damage}") from error


def _checked(entries: list[zipfile.ZipInfo], packed: int, most: int) -> dict[str, zipfile.ZipInfo]:
    if len(entries) > MAX_FILES:
        raise InvalidRequest("file", f"the zip file has {len(entries):,} entries; at most {MAX_FILES:,} are taken")
    total = sum(entry.file_size for entry in entries)
    if total > most:
        raise InvalidRequest("file", f"the zip file unpacks to {total:,} bytes; at most {most:,} are taken")
    if total > max(SMALL, MAX_RATIO * packed):
        raise InvalidRequest("file", f"the zip file of {packed:,} bytes unpacks to {total:,}, which is no mesh's ratio")
    entry_by_name: dict[str, zipfile.ZipInfo] = {}
    seen: set[str] = set()
    for entry in entries:
        name = clean_name(entry.filename)
        form = stat.S_IFMT(entry.external_attr >> 16)
        if form not in (0, stat.S_IFREG, stat.S_IFDIR):
            raise InvalidRequest("file", f"{entry.filename!r} in the zip file is a link or a device, and no file")
        if entry.flag_bits & _ENCRYPTED:
            raise InvalidRequest("file", f"{entry.filename!r} in the zip file is encrypted")
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise InvalidRequest("file", f"{entry.filename!r} in the zip file is compressed, but not by deflate")
        if entry.is_dir() or name.startswith(_IGNORED) or name.endswith(_IGNORED):
            continue
        if name.lower() in seen:
            raise InvalidRequest("file", f"the zip file has two files {name!r}")
        seen.add(name.lower())
        entry_by_name[name] = entry
    return entry_by_name
