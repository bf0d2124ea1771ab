"""Reads the furniture catalogue (models, their creators and their sizes) from `*.sh3f` archives.

The archives are Sweet Home 3D furniture libraries: zip files with a `PluginFurnitureCatalog.properties` that numbers
its models (`name#12=…`) and an OBJ model with materials and textures for each.
"""

import json
import re
import unicodedata
import zipfile
from itertools import chain, count
from pathlib import Path

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from services import atomic_write
from services.scenes.properties import parse_properties

CATALOGUE = "PluginFurnitureCatalog.properties"
IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
INDEX_VERSION = 2


class Model(BaseModel):
    """A model of a furniture library.

    `size` is width (x), depth (z), height (y) in centimetres. `rotation` is the 3×3 matrix, row by row,
    that turns the model upright and its front towards +z. `path` is the OBJ file inside the archive, `icon` the PNG
    file of its picture, if it has one.
    """

    model_config = ConfigDict(frozen=True)

    slug: str
    key: str
    title: str
    category: str
    creator: str
    licence: str
    library: str
    archive: str
    path: str
    size: tuple[float, float, float]
    rotation: tuple[float, ...]
    icon: str | None = None

    @property
    def credit(self) -> str:
        """The attribution line."""
        return f"“{self.title}” by {self.creator}, {self.licence}, from the Sweet Home 3D library {self.library}"


def read_catalogue(directory: Path, index: Path) -> dict[str, Model]:
    """Returns all models of all `*.sh3f` archives in `directory` by slug, in catalogue order; empty if there are none.

    `index` is a cache file of the result, used while the archives have the same names, sizes and modification times.
    """
    archives = sorted(directory.glob("*.sh3f"))
    stamp = [INDEX_VERSION, *([path.name, path.stat().st_size, path.stat().st_mtime_ns] for path in archives)]
    try:
        kept = json.loads(index.read_bytes())
        if kept["stamp"] == stamp:
            models = TypeAdapter(list[Model]).validate_python(kept["models"])
            return {model.slug: model for model in models}
    except (OSError, ValueError, KeyError, TypeError, ValidationError):
        pass
    models = with_slugs([model for path in archives for model in read_archive(path)])
    text = json.dumps({"stamp": stamp, "models": [model.model_dump(mode="json") for model in models]})
    atomic_write.write(index, text.encode())
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
                archive=path.name,
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
