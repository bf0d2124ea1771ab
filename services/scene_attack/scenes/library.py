"""The library of assets that a scene can name: furniture, primitives, uploaded meshes, environment maps."""

import re
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from scene_attack.blobs import blobs
from scene_attack.errors import InvalidRequest
from scene_attack.options import DEFAULTS, Options
from scene_attack.scenes import environment
from scene_attack.scenes.bundle import Bundle
from scene_attack.scenes.environment import FILE_KINDS, EnvironmentMap, read_file, uniform
from scene_attack.scenes.furniture import Model, archive_of, load_model, read_catalogue, read_icon
from scene_attack.scenes.mesh import FIT_RADIUS, Mesh, fitted
from scene_attack.scenes.primitives import PRIMITIVES, primitive
from scene_attack.scenes.scene_file import SceneFile, as_known, node_of, parts_named, upload_of
from scene_attack.scenes.uploads import SCENE_KINDS, Upload, Uploads, is_map
from scene_attack.text import did_you_mean


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


BY_GREG_ZAAL = ("city", "courtyard", "forest", "interior", "night", "studio", "sunrise", "sunset")
"""The environment maps that `assets fetch` brings; three of them are in the package."""
PACKAGED = Path(__file__).with_name("assets")
"""The assets of every installation: `furniture/<slug>.sh3f`, libraries of one model, and `environments/<name>.npz`."""


def own_entry(name: str, kind: Literal["primitive", "environment"]) -> Entry:
    """The entry of an asset that the project makes itself: a primitive, or the uniform map."""
    title = name.rpartition("/")[2].capitalize()
    return Entry(
        name=name, title=title, kind=kind, category=kind, creator="scene-attack", licence="CC0 1.0", credit=None
    )


UNIFORM = own_entry("uniform", "environment")


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
    """The entry of a map in the folder of maps. The creator of a map that the user put there is unknown."""
    known = name in BY_GREG_ZAAL
    return Entry(
        name=name,
        title=name.capitalize(),
        kind="environment",
        category="environment",
        creator="Greg Zaal" if known else "unknown",
        licence="CC0 1.0" if known else "unknown",
        credit=f"Environment map “{name}” by Greg Zaal, CC0 1.0, HDRI Haven (hdrihaven.com), as shipped with Blender"
        if known
        else None,
    )


def _is_there(check: Callable[[str, Callable[[str], bool]], None], may_use: Callable[[str], bool], name: str) -> bool:
    try:
        check(name, may_use)
    except InvalidRequest:
        return False
    return True


KEPT_MESHES = 32
"""Number of recently used meshes kept in memory; a large mesh takes about 30 MB."""
_UPLOAD = re.compile(r"sha256:([0-9a-f]{64})")
FETCH = "`scene-attack assets fetch` brings 800 more models and five more maps"
NAMES = (
    "; a mesh is furniture/<slug>, primitive/<name>, or the sha256:<64 hex digits> that the upload of a file answered; "
    "GET /v1/scenes and `scene-attack assets list` list all of them"
)
"""How meshes are named, for a name that no mesh's is close to."""


class Library:
    """The assets of an installation: those of the package, in cache_dir those that `assets fetch` brought, in `files`
    (`settings.files`) those of users. A name means the package's asset first; the fetched one is the same. Without
    `packaged` there are the others alone: an export is read with nothing but its own files.

    Safe to share between threads. Two Libraries on the same places see the same assets, so that another process is
    given the places alone.
    """

    def __init__(self, cache_dir: Path, files: Path | str, packaged: bool = True) -> None:
        self._places = cache_dir, files, packaged
        self._furniture = cache_dir / "furniture"
        self._environments = [cache_dir / "environments", *([PACKAGED / "environments"] if packaged else [])]
        self._processed = cache_dir / "meshes"
        self._uploads = Uploads(blobs(files, "assets"), self._processed)
        self._lock = threading.RLock()
        self._packaged = read_catalogue(PACKAGED / "furniture") if packaged else {}
        self._models: dict[str, Model] = {}
        self._shipped_entries: list[Entry] = []
        self._meshes: OrderedDict[str, Mesh] = OrderedDict()
        self._maps: dict[str, EnvironmentMap] = {}

    def __reduce__(self) -> tuple[type["Library"], tuple[Path, Path | str, bool]]:
        return type(self), self._places

    def mesh(self, name: str) -> Mesh:
        """Returns the mesh of that name: `furniture/<slug>`, `primitive/<name>`, `sha256:<hex>` of an upload, or a part
        of the scene in one (`scene_file.mesh_of_node`, `mesh_of_rest`).

        Raises InvalidRequest("mesh", …) for an unknown name, with close matches, and JobFailure("asset-missing") if
        its file is damaged.
        """
        with self._lock:
            if name in self._meshes:
                self._meshes.move_to_end(name)
                return self._meshes[name]
        mesh = self._load(name)
        with self._lock:
            self._meshes[name] = mesh
            while len(self._meshes) > KEPT_MESHES:
                self._meshes.popitem(last=False)
        return mesh

    def scene(self, name: str, may_use: Callable[[str], bool] = lambda _: True) -> SceneFile:
        """Returns the scene in an uploaded file, `sha256:<hex>`.

        Raises InvalidRequest("file", …) for another name, an upload for whose name `may_use` is false, and a file that
        has no scene or none that can be used.
        """
        record = self._record(name) if may_use(name) else None
        if record is None:
            raise InvalidRequest(
                "file", f"there is no upload {name!r}; give a path such as ./room.glb, or add the file"
            )
        scene = self._uploads.load_scene(record)
        if scene is None and record.kind in SCENE_KINDS:
            raise InvalidRequest("file", "it was added by a version that read no scenes; add it again")
        if scene is None:
            raise InvalidRequest("file", f"a {record.kind} file holds no scene; {' and '.join(SCENE_KINDS)} files do")
        if scene.unusable:
            raise InvalidRequest("file", f"it is a mesh, but no scene: {scene.unusable}")
        has_mesh, has_map = (partial(_is_there, check, may_use) for check in (self.check_mesh, self.check_map))
        return as_known(scene, name, has_mesh, has_map)

    def check_mesh(self, name: str, may_use: Callable[[str], bool] = lambda _: True) -> None:
        """Raises InvalidRequest("mesh", …) as `mesh` does for an unknown name, without reading a known one's file.

        An upload for whose name `may_use` is false is unknown, too.
        """
        upload = upload_of(name)
        if (_UPLOAD.fullmatch(upload) and not may_use(upload)) or self.entry(upload) is None:
            raise self._unknown_mesh(name)
        if upload != name and not parts_named(name, self._scene(upload)):
            raise InvalidRequest(
                "mesh", f"there is nothing to draw of {name!r}: its file has no such node with triangles"
            )

    def check_map(self, name: str, may_use: Callable[[str], bool] = lambda _: True) -> None:
        """Raises InvalidRequest("environment", …) as `environment` does for an unknown name, without reading its file.

        The map `lights`, which is made of a scene's own lights, is known. An upload for whose name `may_use` is false
        is not.
        """
        if _UPLOAD.fullmatch(name):
            record = self._record(name) if may_use(name) else None
            if record is None or not is_map(record.kind):
                raise InvalidRequest("environment", f"there is no environment map {name!r}")
        elif name != environment.LIGHTS and not (known := {item.name: item for item in self.environments()}).get(name):
            hint = f"; {FETCH}" if name in BY_GREG_ZAAL else did_you_mean(name, known)
            raise InvalidRequest("environment", f"there is no environment map {name!r}{hint}")

    def has_upload(self, name: str) -> bool:
        """Whether there is an uploaded mesh of that name, `sha256:<hex>`, or of a part of its scene."""
        return self._record(name) is not None

    def titles(self, names: Iterable[str]) -> dict[str, str]:
        """The titles that people gave uploads, and the names of the nodes of scenes, by name; `names` may have others,
        which are left out."""
        found = {}
        for name in names:
            node, record = node_of(name), self._record(name)
            nodes = () if node is None else self._scene(name).nodes
            if node is not None and node < len(nodes):
                found[name] = nodes[node].name
            elif record is not None and record.about.title is not None:
                found[name] = record.about.title
        return {name: title for name, title in found.items() if title}

    def upload(self, name: str) -> Bundle | None:
        """Returns an upload as it was sent, a mesh or a map; None for a name that is no upload's.

        Raises JobFailure("asset-missing") if its files are missing or changed.
        """
        record = self._record(name)
        return None if record is None else self._uploads.bundle(record)

    def furniture_archive(self, name: str) -> bytes | None:
        """Returns a furniture library of one model, `furniture/<slug>`; None for another name."""
        model = self._model(name)
        return None if model is None else archive_of(model)

    def map_file(self, name: str) -> Path | None:
        """Returns the file of an environment map; None for `uniform`, for an upload, and for an unknown one."""
        return self._map_files().get(name)

    def remove_upload(self, name: str) -> None:
        """Removes the files of an uploaded mesh, if there are any. Other processes may keep it in memory."""
        upload = _UPLOAD.fullmatch(name)
        if upload is not None:
            with self._lock:
                self._meshes.pop(name, None)
            self._uploads.remove(upload[1])

    def entries(
        self,
        category: str | None = None,
        creator: str | None = None,
        licence: str | None = None,
        search: str | None = None,
        may_see: Callable[[str], bool] = lambda _: True,
    ) -> list[Entry]:
        """Lists the meshes that match every filter, case-insensitively, by kind and then by name.

        category, creator and licence match if they are equal; search matches if every word of it is part of the name,
        title, category or creator. Furniture is listed only if its library is installed, and an upload only if
        `may_see` is true for its name; the record of no other one is read.
        """
        words = (search or "").lower().split()
        due = {"category": category, "creator": creator, "licence": licence}

        def matches(entry: Entry) -> bool:
            text = f"{entry.name} {entry.title} {entry.category} {entry.creator}".lower()
            equal = all(value is None or getattr(entry, name).lower() == value.lower() for name, value in due.items())
            return equal and all(word in text for word in words)

        uploads = self._uploads.all(lambda sha256: may_see(f"sha256:{sha256}"))
        return [entry for entry in (*self._shipped(), *map(upload_entry, uploads)) if matches(entry)]

    def entry(self, name: str) -> Entry | None:
        """Returns the entry of a mesh; None if there is none of that name."""
        if _UPLOAD.fullmatch(name):
            record = self._record(name)
            return None if record is None else upload_entry(record)
        return next((entry for entry in self._shipped() if entry.name == name), None)

    def picture(self, name: str) -> bytes | None:
        """Returns the PNG file of the picture that a furniture library has of a mesh, `furniture/<slug>`; else None."""
        model = self._model(name)
        return None if model is None else read_icon(model)

    def thumbnail(self, name: str) -> bytes | None:
        """Returns the thumbnail of an upload, a PNG file; None if none was kept yet."""
        return self._uploads.thumbnail(name.removeprefix("sha256:"))

    def keep_thumbnail(self, name: str, png: bytes) -> None:
        """Stores the thumbnail of an upload, if it is still there."""
        if self.has_upload(name):
            self._uploads.keep_thumbnail(name.removeprefix("sha256:"), png)

    def add_mesh(self, data: bytes, kind: str, limits: Options = DEFAULTS) -> Entry:
        """Adds a mesh that is a single file, as `add`."""
        return self.add(Bundle(kind, data, {}), limits)

    def add(self, bundle: Bundle, limits: Options = DEFAULTS) -> Entry:
        """Validates an uploaded mesh and its files, stores them by their SHA-256 and returns the mesh's entry.

        The same bytes give the same entry. Raises
        InvalidRequest("file" or "kind", …), and JobFailure("internal") if the file cannot be read now.
        """
        return upload_entry(self._uploads.add(bundle, limits))

    def environment(self, name: str) -> EnvironmentMap:
        """Returns the environment map of that name, which may be that of an upload.

        Raises InvalidRequest("environment", …) with close matches.
        """
        if (record := self._record(name)) is not None and is_map(record.kind):
            return self._uploads.load_map(record)
        with self._lock:
            if name not in self._maps:
                self.check_map(name)
                path, credit = self._map_files().get(name), environment_entry(name).credit
                self._maps[name] = uniform() if path is None else read_file(path, credit)
            return self._maps[name]

    def environments(self) -> list[Entry]:
        """Lists the environment maps by name; `uniform`, radiance 1 in every direction, is always among them."""
        return sorted([*map(environment_entry, self._map_files()), UNIFORM], key=lambda entry: entry.name)

    def _map_files(self) -> dict[str, Path]:
        """The files of all environment maps by name, the package's last: it replaces a fetched one of its name."""
        files = [path for folder in self._environments for path in folder.glob("*") if path.suffix in FILE_KINDS]
        return {path.stem: path for path in files if path.stem != UNIFORM.name}

    def _record(self, name: str) -> Upload | None:
        """The metadata of an upload, `sha256:<hex>`, or of the one that a part of a scene is of; None for another name,
        and for one that is not there."""
        upload = _UPLOAD.fullmatch(upload_of(name))
        return None if upload is None else self._uploads.record(upload[1])

    def _load(self, name: str) -> Mesh:
        kind, _, rest = name.partition("/")
        if kind == "primitive" and rest in PRIMITIVES:
            return primitive(rest)
        if (upload := self._record(name)) is not None:
            if is_map(upload.kind):
                raise InvalidRequest("mesh", f"{name!r} is an environment map, for lights.environment.map")
            whole = self._uploads.load(upload)
            return whole if name == upload_of(name) else self._part_of_scene(name, whole)
        if (model := self._model(name)) is not None:
            return load_model(model, self._processed)
        raise self._unknown_mesh(name)

    def _scene(self, name: str) -> SceneFile:
        """The scene of an upload, or of that of which a part is named, as it is stored; an empty one if it has none."""
        record = self._record(name)
        return (None if record is None else self._uploads.load_scene(record)) or SceneFile()

    def _part_of_scene(self, name: str, whole: Mesh) -> Mesh:
        """The mesh of a node, fitted, or of all but some nodes, in the frame of the whole file's mesh."""
        scene = self._scene(name)
        numbers = parts_named(name, scene)
        if not numbers or scene.extent is None:
            raise self._unknown_mesh(name)
        parts = tuple(whole.parts[k] for k in numbers)
        node = node_of(name)
        extent = scene.extent if node is None else scene.nodes[node].extent
        if extent is None:
            raise InvalidRequest("mesh", f"all vertices of {name!r} are at one point")
        return Mesh(
            parts=parts if node is None else fitted(parts),
            sha256=sha256(f"{name} {whole.sha256}".encode()).hexdigest(),
            credit=whole.credit,
            centimetres=100 * extent.radius / FIT_RADIUS,
        )

    def _unknown_mesh(self, name: str) -> InvalidRequest:
        """The error for a name that is none. It suggests no upload, which may be somebody else's."""
        known = [entry.name for entry in self._shipped()]
        same = [other for other in known if other.rpartition("/")[2] == name.lower()]  # without its folder
        hint = f"; did you mean {same[0]!r}?" if same else did_you_mean(name, known)
        if name.startswith("furniture/") and not self._fetched():
            hint += f"; {FETCH}"
        return InvalidRequest("mesh", f"there is no mesh {name!r}{hint or NAMES}")

    def _model(self, name: str) -> Model | None:
        """The model of a piece of furniture, `furniture/<slug>`; None for another name."""
        kind, _, slug = name.partition("/")
        return self._catalogue().get(slug) if kind == "furniture" else None

    def _catalogue(self) -> dict[str, Model]:
        return self._fetched() | self._packaged

    def _fetched(self) -> dict[str, Model]:
        with self._lock:
            # Read an empty catalogue again each time: another process may be fetching it.
            if not self._models:
                self._models = read_catalogue(self._furniture)
            return self._models

    def _shipped(self) -> list[Entry]:
        """The furniture and the primitives. They are kept: to make them anew takes longer than all else of a list."""
        with self._lock:
            if not self._fetched() or not self._shipped_entries:
                models = self._catalogue().values()
                furniture = sorted(map(furniture_entry, models), key=lambda entry: entry.name)
                solids = [own_entry(f"primitive/{name}", "primitive") for name in sorted(PRIMITIVES)]
                self._shipped_entries = [*furniture, *solids]
            return self._shipped_entries
