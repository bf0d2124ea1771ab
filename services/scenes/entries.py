"""The entries of a library: what a scene can name, with its attribution."""

from collections.abc import Iterable
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from services.scenes.catalogue import Model
from services.scenes.uploads import Upload, is_map


class Entry(BaseModel):
    """An asset that a scene can name, with its attribution. `size` is width, depth and height in centimetres."""

    model_config = ConfigDict(frozen=True)

    name: str
    title: str
    kind: Literal["furniture", "primitive", "upload", "environment"]
    category: str
    creator: str
    licence: str
    credit: str | None
    size: tuple[float, float, float] | None = None
    triangles: int | None = None
    used: tuple[str, ...] = Field((), description="what an uploaded mesh shows of its files: textures, maps, colours")
    notes: tuple[str, ...] = Field((), description="what it does not show of them, and what files are missing")


FETCHED = ("city", "courtyard", "forest", "interior", "night", "studio", "sunrise", "sunset")
"""The environment maps that scripts/setup fetches."""
UNIFORM = Entry(
    name="uniform",
    title="Uniform",
    kind="environment",
    category="environment",
    creator="scene-attack",
    licence="CC0 1.0",
    credit=None,
)


def has_words(entry: Entry, words: Iterable[str]) -> bool:
    """Whether every word is part of the name, title, category or creator; the words are in lower case."""
    text = f"{entry.name} {entry.title} {entry.category} {entry.creator}".lower()
    return all(word in text for word in words)


def furniture_entry(model: Model) -> Entry:
    """The entry of a piece of furniture."""
    return Entry(
        name=f"furniture/{model.slug}",
        title=model.title,
        kind="furniture",
        category=model.category,
        creator=model.creator,
        licence=model.licence,
        credit=model.credit,
        size=model.size,
    )


def solid_entry(name: str) -> Entry:
    """The entry of a primitive."""
    return Entry(
        name=f"primitive/{name}",
        title=name.capitalize(),
        kind="primitive",
        category="primitive",
        creator="scene-attack",
        licence="CC0 1.0",
        credit=None,
    )


def upload_entry(record: Upload) -> Entry:
    """The entry of an upload, a mesh or an environment map."""
    of_map = is_map(record.kind)
    return Entry(
        name=f"sha256:{record.sha256}",
        title=record.about.title or f"Uploaded {record.kind} {'map' if of_map else 'mesh'} {record.sha256[:8]}",
        kind="environment" if of_map else "upload",
        category="upload",
        creator="uploader",
        licence=record.about.licence or "unknown",
        credit=record.about.credit,
        triangles=None if of_map else record.triangles,
        used=record.used,
        notes=record.notes,
    )


def environment_entry(name: str) -> Entry:
    """The entry of a map in the folder of maps. Of one that the set-up did not fetch, nobody knows whose it is."""
    fetched = name in FETCHED
    return Entry(
        name=name,
        title=name.capitalize(),
        kind="environment",
        category="environment",
        creator="Greg Zaal" if fetched else "unknown",
        licence="CC0 1.0" if fetched else "unknown",
        credit=f"Environment map “{name}” by Greg Zaal, CC0 1.0, HDRI Haven (hdrihaven.com), as shipped with Blender"
        if fetched
        else None,
    )
