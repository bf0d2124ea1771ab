"""The furniture library: its catalogue (models, their creators and sizes), and its models as meshes.

The archives (`*.sh3f`) are Sweet Home 3D furniture libraries: zip files with a `PluginFurnitureCatalog.properties`, in
Java's .properties format, that numbers its models (`name#12=…`), and an OBJ model with materials and textures for each.
A model is turned upright, scaled to its catalogue size and fitted.

The kinds of its models, what a person would call them ("chair", "hand tool"), were reviewed by hand. The truth of a
scene and the classes of the networks that we train follow from this table. A model whose kind is in doubt has none.
`Entry.category` is the creators' own word, which is a room ("Bedroom") as often as a kind.
"""

import hashlib
import json
import posixpath
import re
import unicodedata
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache
from io import BytesIO
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import BaseModel, ConfigDict

from scene_attack.errors import JobFailure
from scene_attack.scenes.mesh import Mesh, Part
from scene_attack.scenes.store import load_parts, mesh_path, save_parts

if TYPE_CHECKING:
    from scene_attack.scenes.reading.surfaces import Surface

_ESCAPES = {"t": "\t", "n": "\n", "r": "\r", "f": "\f"}


def parse_properties(data: bytes) -> dict[str, str]:
    """Returns the keys and values of a .properties file.

    The file is Latin-1 with backslash escapes, continued lines, and comments that begin with `#` or `!`.
    A repeated key keeps its last value. A malformed backslash-u escape is kept as written.
    """
    values: dict[str, str] = {}
    for line in _logical_lines(data.decode("latin-1")):
        match = re.match(r"((?:\\.|[^\\=:\s])*)[ \t\f]*[=:]?[ \t\f]*(.*)", line, re.DOTALL)
        assert match is not None  # every part may be empty
        values[_unescape(match[1])] = _unescape(match[2])
    return values


def write_properties(values: Mapping[str, str]) -> bytes:
    """Returns a .properties file, which `parse_properties` reads; keys have neither blanks nor `:`, `=` or a backslash,
    and values neither begin nor end with blanks.
    """
    return "".join(f"{key}={_escaped(value)}\n" for key, value in values.items()).encode("ascii")


def _escaped(text: str) -> str:
    return "".join(c if " " <= c <= "~" and c != "\\" else f"\\u{ord(c):04x}" for c in text)


def _logical_lines(text: str) -> Iterator[str]:
    lines = iter(re.split(r"\r\n|\r|\n", text))
    for raw in lines:
        line = raw.lstrip(" \t\f")
        if not line or line[0] in "#!":
            continue
        # An odd number of backslashes at the end continues the line.
        while (len(line) - len(line.rstrip("\\"))) % 2:
            line = line[:-1] + next(lines, "").lstrip(" \t\f")
        yield line


def _unescape(text: str) -> str:
    def character(match: re.Match[str]) -> str:
        if match[1]:
            return chr(int(match[1], 16))
        return _ESCAPES.get(match[2], match[2])

    return re.sub(r"\\(?:u([0-9a-fA-F]{4})|(.))", character, text, flags=re.DOTALL)


CATALOGUE = "PluginFurnitureCatalog.properties"
ICON = "icon.png"
"""Name of a model's picture in an archive of one model."""
FETCH = "run `scene-attack assets fetch`"
IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


class Model(BaseModel):
    """A model of a furniture library.

    `size` is width (x), depth (z), height (y) in centimetres. `rotation` is the 3×3 matrix, row by row,
    that turns the model upright and its front towards +z. `archive` is the library's file, `path` the OBJ file inside
    it, `icon` the PNG file of its picture, if it has one.
    """

    model_config = ConfigDict(frozen=True)

    slug: str
    key: str
    title: str
    category: str
    creator: str
    licence: str
    library: str
    archive: Path
    path: str
    size: tuple[float, float, float]
    rotation: tuple[float, ...]
    icon: str | None = None

    @property
    def credit(self) -> str:
        """The attribution line."""
        return f"“{self.title}” by {self.creator}, {self.licence}, from the Sweet Home 3D library {self.library}"


def read_catalogue(directory: Path) -> dict[str, Model]:
    """Returns the models of all `*.sh3f` archives in `directory` by slug, in catalogue order; empty without them."""
    models = with_slugs([model for path in sorted(directory.glob("*.sh3f")) for model in read_archive(path)])
    return {model.slug: model for model in models}


def read_archive(path: Path) -> list[Model]:
    """Returns the models of an archive, in the order of their numbers.

    Their slugs are still empty, but in an archive of one model, which `archive_of` writes for an export. Models without
    a name, a size or an OBJ file that is in the archive are left out.
    """
    with zipfile.ZipFile(path) as archive:
        values = parse_properties(archive.read(CATALOGUE))
        files = set(archive.namelist())
    library = values.get("name", path.stem).removesuffix(" catalog")
    licence = _licence(values.get("license", ""))
    models = []
    for number in sorted(int(key.partition("#")[2]) for key in values if re.fullmatch(r"name#\d+", key)):
        title = values[f"name#{number}"].strip()
        model = values.get(f"model#{number}", "").strip().lstrip("/")
        size = tuple(_number(values.get(f"{side}#{number}", "")) for side in ("width", "depth", "height"))
        if not title or model not in files or not model.lower().endswith(".obj") or min(size) <= 0:
            continue
        icon = values.get(f"icon#{number}", "").strip().lstrip("/")
        identity = values.get(f"id#{number}", title)
        models.append(
            Model(
                slug=values.get(f"slug#{number}", ""),
                key=identity.rpartition("#")[2],
                title=title,
                category=values.get(f"category#{number}", "").strip() or "Miscellaneous",
                creator=values.get(f"creator#{number}", "").strip() or library,
                licence=licence,
                library=library,
                archive=path,
                path=model,
                size=(size[0], size[1], size[2]),
                rotation=_rotation(values.get(f"modelRotation#{number}", "")),
                icon=icon if icon in files and icon.lower().endswith(".png") else None,
            )
        )
    return models


def with_slugs(models: list[Model]) -> list[Model]:
    """Returns the models, each with a unique slug: the one that it has, or its title; if taken, with its key, its
    library or a number added.

    Slugs are assigned in the order of the list, so a slug means the same model as long as no archive is added before
    its own.
    """
    taken: set[str] = set()
    named: list[Model] = []
    for model in models:
        plain, key = slugify(model.title) or "model", slugify(model.key)
        words = key if key.startswith(plain) else slugify(f"{plain} {key}")
        longer = slugify(f"{words} {model.library}")
        numbered = (f"{words}-{n}" for n in count(2))
        slug = model.slug or next(slug for slug in chain((plain, words, longer), numbered) if slug not in taken)
        taken.add(slug)
        named.append(model.model_copy(update={"slug": slug}))
    return named


def slugify(text: str) -> str:
    """Returns `text` as lower-case ASCII letters and digits with single hyphens: "Café table (2)" → "cafe-table-2"."""
    ascii_only = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    return re.sub(r"[^a-z0-9]+", "-", ascii_only.lower()).strip("-")


def _licence(text: str) -> str:
    lowered = text.lower()
    if "public domain" in lowered or "cc-0" in lowered or "cc0" in lowered:
        return "CC0 1.0"
    if "attribution 3.0" in lowered:
        return "CC BY 3.0 US" if "united states" in lowered else "CC BY 3.0"
    return text.strip() or "unknown"


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return 0.0


def _rotation(text: str) -> tuple[float, ...]:
    values = tuple(_number(word) for word in text.split())
    return values if len(values) == 9 else IDENTITY


def load_model(model: Model, cache: Path) -> Mesh:
    """Returns the mesh of a catalogue model.

    `cache` is the directory of processed meshes. The mesh's sha256 covers the model's size and rotation and every file
    it uses. Raises JobFailure("asset-missing") if the archive is missing or damaged.
    """
    files = _read(model)
    digest = _digest(model, files)
    kept = mesh_path(cache, digest)
    parts = load_parts(kept)
    if parts is None:
        # trimesh takes half a second to import, and a cached mesh does not need it
        from scene_attack.scenes.reading.surfaces import read_obj, to_parts

        parts = to_parts(upright(model, read_obj(files, posixpath.basename(model.path))))
        save_parts(kept, parts)
    return Mesh(parts=parts, sha256=digest, credit=model.credit, centimetres=_centimetres(model, parts))


def archive_of(model: Model) -> bytes:
    """Returns a furniture library, a `*.sh3f` file, of one model under the slug that it has in the whole library.

    It has the model's picture, if there is one.

    Raises JobFailure("asset-missing") if the archive is missing or damaged.
    """
    width, depth, height = model.size
    values = {
        "name": model.library,
        "license": model.licence,
        "slug#1": model.slug,
        "id#1": model.key,
        "name#1": model.title,
        "category#1": model.category,
        "creator#1": model.creator,
        "model#1": f"/{model.path}",
        "width#1": repr(width),
        "depth#1": repr(depth),
        "height#1": repr(height),
        "modelRotation#1": " ".join(map(repr, model.rotation)),
    }
    folder, buffer = posixpath.dirname(model.path), BytesIO()
    files = {f"{folder}/{name}": data for name, data in _read(model).items()}
    if (icon := read_icon(model)) is not None:
        values["icon#1"], files[ICON] = f"/{ICON}", icon
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in ((CATALOGUE, write_properties(values)), *files.items()):
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), data, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def read_icon(model: Model) -> bytes | None:
    """Returns the PNG file of the picture that the archive has of the model; None if it has none that can be read."""
    if model.icon is None:
        return None
    try:
        with zipfile.ZipFile(model.archive) as archive:
            data = archive.read(model.icon)
    except (OSError, KeyError, zipfile.BadZipFile):
        return None
    return data if data.startswith(b"\x89PNG\r\n\x1a\n") else None


def upright(model: Model, surfaces: "list[Surface]") -> "list[Surface]":
    """Returns the surfaces turned by the model's rotation and scaled to its width, height and depth, in centimetres.

    An axis along which the model has no extent (a flat image) is not scaled.
    """
    rotation = np.asarray(model.rotation, np.float64).reshape(3, 3)
    turned = [surface.vertices @ rotation.T for surface in surfaces]
    used = np.concatenate([v[np.unique(s.faces)] for v, s in zip(turned, surfaces, strict=True) if len(s.faces)])
    extent = used.max(axis=0) - used.min(axis=0)
    width, depth, height = model.size
    flat = extent < 1e-9 * extent.max()
    scale = np.where(flat, 1.0, np.array([width, height, depth]) / np.where(flat, 1.0, extent))
    return [replace(surface, vertices=v * scale) for surface, v in zip(surfaces, turned, strict=True)]


def _centimetres(model: Model, parts: tuple[Part, ...]) -> float:
    """Returns the real length of a unit of the fitted mesh, from its longest side and the catalogue's."""
    points = np.concatenate([part.vertices[np.unique(part.faces)] for part in parts]).astype(np.float64)
    extent = points.max(axis=0) - points.min(axis=0)
    width, depth, height = model.size
    longest = int(extent.argmax())
    return float((width, height, depth)[longest] / extent[longest])


def _read(model: Model) -> dict[str, bytes]:
    """Returns the files of a model. Raises JobFailure("asset-missing") if its archive is missing or damaged."""
    try:
        with zipfile.ZipFile(model.archive) as archive:
            return _files(archive, model.path)
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        raise JobFailure("asset-missing", f"cannot read {model.archive.name}: {error}; {FETCH} again") from error


def _files(archive: zipfile.ZipFile, path: str) -> dict[str, bytes]:
    """Returns the contents of the model's OBJ file, material libraries and textures, by name relative to its folder."""
    archive.getinfo(path)  # raises KeyError if the model itself is missing
    folder = posixpath.dirname(path) + "/"
    names = sorted(name for name in archive.namelist() if name.startswith(folder) and not name.endswith("/"))
    endings = (".obj", ".mtl", ".png", ".jpg", ".jpeg", ".bmp", ".gif")
    return {
        name.removeprefix(folder): archive.read(name)
        for name in names
        if name == path or (name.lower().endswith(endings) and not name.lower().endswith(".obj"))
    }


def _digest(model: Model, files: dict[str, bytes]) -> str:
    digest = hashlib.sha256(repr((model.size, model.rotation)).encode())
    for name, data in sorted(files.items()):
        digest.update(f"\n{name}\n{len(data)}\n".encode())
        digest.update(data)
    return digest.hexdigest()


PREFIX = "furniture/"


@cache
def kinds() -> dict[str, tuple[str, ...]]:
    """Returns the names of the meshes of each kind, {kind: ("furniture/<slug>", …)}, in the table's order."""
    table = json.loads(Path(__file__).with_name("furniture_kinds.json").read_text())
    return {kind: tuple(PREFIX + slug for slug in slugs) for kind, slugs in table.items()}


def kind_of(mesh: str) -> str | None:
    """Returns the kind of a mesh by its name ("furniture/couch" → "sofa"), or None where nobody has said it."""
    return _kinds_by_mesh().get(mesh)


@cache
def _kinds_by_mesh() -> dict[str, str]:
    return {mesh: kind for kind, meshes in kinds().items() for mesh in meshes}
