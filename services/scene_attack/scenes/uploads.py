"""Stores meshes that users upload: parsed once, and named by a hash, never by a user's file name.

The hash covers the bytes, the kind they were read as and the version of the parser, so that a name means one mesh for
ever. What was parsed is kept with the bytes: a later parser reads only what is uploaded later.
"""

import hashlib
import posixpath
import zipfile
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from scene_attack import disk
from scene_attack.blobs import Blobs
from scene_attack.errors import InvalidRequest, JobFailure
from scene_attack.options import DEFAULTS, Options
from scene_attack.scenes.bundle import MAP_KINDS, NOTHING_SAID, PARSER, SIGNATURE, About, Bundle, bundle_of, clean_name
from scene_attack.scenes.environment import EnvironmentMap, radiance_of
from scene_attack.scenes.mesh import Mesh
from scene_attack.scenes.reading.isolated import Report, reader
from scene_attack.scenes.scene_file import SceneFile
from scene_attack.scenes.store import load_parts, mesh_path, save_parts
from scene_attack.strict import absent


class Upload(BaseModel):
    """Metadata of an uploaded mesh, stored beside it as JSON. `size` is in bytes.

    sha256: the name, see `Bundle.sha256`. mesh_sha256: the SHA-256 of the file of what was parsed. scene_sha256: that
    of the scene in it; None if its format has none, or it was stored before scenes were read.
    """

    model_config = ConfigDict(frozen=True)

    sha256: str
    kind: str
    parser: int
    mesh_sha256: str
    size: int
    triangles: int
    about: About = NOTHING_SAID
    used: tuple[str, ...] = ()
    """Files and their features that the mesh shows."""
    notes: tuple[str, ...] = ()
    """Features that the mesh does not show, and files that are missing."""
    scene_sha256: str | None = Field(default=None, exclude_if=absent)


def max_unpacked(limits: Options) -> int:
    """Largest size of all files of an upload together, unpacked, bytes. The request body has a limit of its own."""
    return 4 * limits.max_upload_bytes


SCENE_KINDS = ("glb", "gltf")
"""Kinds of mesh files that may hold a whole scene."""


def is_map(kind: str) -> bool:
    """Whether an upload of a kind is an environment map, and no mesh."""
    return kind in MAP_KINDS


def _read_mesh(bundle: Bundle, kept: Path, limits: Options) -> tuple[int, Report]:
    """Parses a mesh into the file `kept`. Returns its number of triangles, and what became of its files."""
    parts, report = reader().read_mesh(bundle.data, bundle.kind, limits.max_faces, bundle.others, bundle.about.up)
    save_parts(kept, parts)
    return sum(len(part.faces) for part in parts), report


def _read_map(bundle: Bundle, kept: Path) -> tuple[int, Report]:
    """Parses an environment map into the file `kept`; as `_read_mesh`."""
    texels = reader().read_map(bundle.data, bundle.kind)
    height, width = texels.shape[:2]
    with disk.replacing(kept) as part, part.open("wb") as file:
        np.savez(file, allow_pickle=False, texels=texels)
    odd = () if width == 2 * height else (f"it has {width}×{height} texels, and is shown as if it were twice as wide",)
    return 0, Report((f"{width}×{height} texels",), odd)


class Uploads:
    """The uploaded meshes in one place.

    `<sha256>` has the bytes (`Bundle.stored`), `<sha256>.npz` what was parsed, `<sha256>.scene` the `SceneFile` of a
    file that has one, `<sha256>.json` an `Upload`, and `<sha256>.png` a thumbnail once one was made. `processed` is a
    cache of the parsed meshes, which may be deleted at any time.
    """

    def __init__(self, files: Blobs, processed: Path) -> None:
        self._files = files
        self._processed = processed

    def add(self, bundle: Bundle, limits: Options = DEFAULTS) -> Upload:
        """Validates and stores a mesh with its files, and returns its metadata; what is stored already is not
        validated again.

        Raises InvalidRequest("kind", …) for a kind that is not read, InvalidRequest("file", …) for invalid or too many
        bytes.
        """
        most = limits.max_upload_bytes if not bundle.others else max_unpacked(limits)
        if bundle.size > most:
            raise InvalidRequest("file", f"it has {bundle.size:,} bytes; at most {most:,} are taken")
        sha256 = bundle.sha256
        known = self.record(sha256)
        if known is not None and (known.scene_sha256 or known.kind not in SCENE_KINDS):
            return known
        kept = self._kept(sha256)
        triangles, report = _read_map(bundle, kept) if is_map(bundle.kind) else _read_mesh(bundle, kept, limits)
        parsed = kept.read_bytes()
        scene = None if report.scene is None else report.scene.model_dump_json().encode()
        record = Upload(
            sha256=sha256,
            kind=bundle.kind,
            parser=PARSER,
            mesh_sha256=hashlib.sha256(parsed).hexdigest(),
            size=bundle.size,
            triangles=triangles,
            about=bundle.about,
            used=report.used,
            notes=report.dropped,
            scene_sha256=None if scene is None else hashlib.sha256(scene).hexdigest(),
        )
        # The metadata is written last, so that every listed upload is complete.
        self._files.write(sha256, bundle.stored())
        self._files.write(f"{sha256}.npz", parsed)
        if scene is not None:
            self._files.write(f"{sha256}.scene", scene)
        self._files.write(f"{sha256}.json", record.model_dump_json().encode())
        return record

    def record(self, sha256: str) -> Upload | None:
        """Returns the metadata of the upload with this digest (64 hexadecimal digits); None if there is none."""
        try:
            with self._files.open(f"{sha256}.json") as file:
                return Upload.model_validate_json(file.read())
        except (FileNotFoundError, ValidationError):
            return None

    def thumbnail(self, sha256: str) -> bytes | None:
        """Returns the thumbnail of the upload with this digest, a PNG file; None if none was kept yet."""
        try:
            with self._files.open(f"{sha256}.png") as file:
                return file.read()
        except FileNotFoundError:
            return None

    def keep_thumbnail(self, sha256: str, png: bytes) -> None:
        """Stores the thumbnail of an upload."""
        self._files.write(f"{sha256}.png", png)

    def bundle(self, upload: Upload) -> Bundle:
        """Returns an upload as it was sent. Raises JobFailure("asset-missing") if its files are missing or changed."""
        data = self._read(upload.sha256, None, upload)
        files = {f"mesh.{upload.kind}": data}
        if len(data) != upload.size:  # the zip file of `Bundle.stored`, which is longer than what it holds
            with zipfile.ZipFile(BytesIO(data)) as archive:
                files = {name: archive.read(name) for name in archive.namelist()}
        bundle = bundle_of(files, upload.kind, next(iter(files)), upload.about)
        if bundle.sha256 != upload.sha256:
            raise JobFailure("asset-missing", f"the uploaded mesh {upload.sha256} has changed where it is kept")
        return bundle

    def remove(self, sha256: str) -> None:
        """Removes the files of the upload with this digest, those that there are. Nobody may be about to add it."""
        for ending in (
            ".json",
            ".npz",
            ".scene",
            ".png",
            "",
        ):  # the metadata first, so that every listed upload is complete
            self._files.delete(f"{sha256}{ending}")
        self._kept(sha256).unlink(missing_ok=True)

    def all(self, selected: Callable[[str], bool] = lambda _: True) -> list[Upload]:
        """Returns the metadata of the uploads for whose digest `selected` is true, ordered by digest."""
        names = [name.removesuffix(".json") for name in self._files.names() if name.endswith(".json")]
        return [record for record in map(self.record, filter(selected, names)) if record is not None]

    def load(self, upload: Upload) -> Mesh:
        """Returns the mesh of an upload. Raises JobFailure("asset-missing") if its files are missing or changed."""
        kept = self._kept(upload.sha256)
        parts = load_parts(kept)
        if parts is None:
            disk.write(kept, self._read(f"{upload.sha256}.npz", upload.mesh_sha256, upload))
            parts = load_parts(kept)
        if parts is None:
            raise JobFailure("asset-missing", f"the parsed mesh of the upload {upload.sha256} cannot be read any more")
        return Mesh(parts=parts, sha256=upload.sha256, credit=upload.about.credit)

    def load_scene(self, upload: Upload) -> SceneFile | None:
        """Returns the scene of an upload; None if it was stored without one. Raises JobFailure("asset-missing") as
        `load` does."""
        if upload.scene_sha256 is None:
            return None
        return SceneFile.model_validate_json(self._read(f"{upload.sha256}.scene", upload.scene_sha256, upload))

    def load_map(self, upload: Upload) -> EnvironmentMap:
        """Returns an uploaded environment map. Raises JobFailure("asset-missing") if its file is missing or changed."""
        name = f"{upload.sha256}.npz"
        with np.load(BytesIO(self._read(name, upload.mesh_sha256, upload)), allow_pickle=False) as arrays:
            radiance = radiance_of(arrays["texels"])
        return EnvironmentMap(f"sha256:{upload.sha256}", radiance, upload.sha256, upload.about.credit)

    def _read(self, name: str, sha256: str | None, upload: Upload) -> bytes:
        try:
            with self._files.open(name) as file:
                data = file.read()
        except FileNotFoundError as error:
            raise JobFailure("asset-missing", f"the uploaded mesh {upload.sha256} has gone: {error}") from error
        if sha256 is not None and hashlib.sha256(data).hexdigest() != sha256:
            raise JobFailure("asset-missing", f"the uploaded mesh {upload.sha256} has changed where it is kept")
        return data

    def _kept(self, sha256: str) -> Path:
        return mesh_path(self._processed, sha256)


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
