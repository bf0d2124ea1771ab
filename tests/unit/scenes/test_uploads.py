"""Uploaded meshes in the library: limits from the settings, storage by content hash, and lost files."""

import json

import numpy as np
import pytest

from services.errors import InvalidRequest, JobFailure
from services.scenes import uploads
from services.scenes.library import Library
from services.settings import Settings
from tests.unit.scenes.mesh_files import ASCII_PLY, BOXES


def test_the_limits_of_uploads_are_those_of_the_settings(tmp_path, monkeypatch):
    library = Library(tmp_path / "cache", tmp_path / "data")
    monkeypatch.setattr(uploads, "settings", lambda: Settings(max_upload_bytes=len(BOXES["obj"]) - 1))
    with pytest.raises(InvalidRequest, match=r"file: it has .* bytes; at most"):
        library.add_mesh(BOXES["obj"], "obj")
    monkeypatch.setattr(uploads, "settings", lambda: Settings(max_faces=11))
    with pytest.raises(InvalidRequest, match="at most 11"):
        library.add_mesh(BOXES["obj"], "obj")
    assert not (tmp_path / "data" / "assets").exists(), "nothing is kept of what was refused"


def test_an_upload_is_stored_once_under_its_content_hash(tmp_path):
    library = Library(tmp_path / "cache", tmp_path / "data")
    first, second = library.add_mesh(BOXES["stl"], "stl"), library.add_mesh(BOXES["stl"], "stl")
    assert first == second
    assets = tmp_path / "data" / "assets"
    digest = first.name.removeprefix("sha256:")
    assert sorted(path.name for path in assets.iterdir()) == [digest, f"{digest}.json"]
    assert (assets / digest).read_bytes() == BOXES["stl"]
    assert json.loads((assets / f"{digest}.json").read_bytes()) == {
        "sha256": digest,
        "kind": "stl",
        "size": len(BOXES["stl"]),
        "triangles": 12,
        "notes": [],
    }
    assert library.mesh(first.name).sha256 == digest


@pytest.mark.parametrize(
    ("data", "kind", "named"),
    [
        (b"# by hand\nmtllib my torus.mtl \r\n" + BOXES["obj"], "obj", ["my torus.mtl"]),
        (BOXES["obj"], "obj", []),
        (ASCII_PLY.replace(b"element vertex", b"comment TextureFile wood.png\nelement vertex", 1), "ply", ["wood.png"]),
        (BOXES["glb"], "glb", []),
    ],
)
def test_a_file_that_names_others_is_taken_and_said_to_lack_them(tmp_path, data, kind, named):
    library = Library(tmp_path / "cache", tmp_path / "data")
    entry = library.add_mesh(data, kind)
    assert [note.split(",")[0] for note in entry.notes] == [f"Its materials and textures are in {one}" for one in named]
    assert library.entries(category="upload") == [entry]


def test_an_upload_stored_before_there_were_notes_is_read(tmp_path):
    library = Library(tmp_path / "cache", tmp_path / "data")
    entry = library.add_mesh(BOXES["stl"], "stl")
    path = tmp_path / "data" / "assets" / f"{entry.name.removeprefix('sha256:')}.json"
    stored = json.loads(path.read_bytes())
    del stored["notes"]
    path.write_text(json.dumps(stored))
    assert library.entries(category="upload") == [entry]


def test_a_deleted_processed_mesh_is_made_again(tmp_path):
    entry = Library(tmp_path / "cache", tmp_path / "data").add_mesh(BOXES["ply"], "ply")
    before = Library(tmp_path / "cache", tmp_path / "data").mesh(entry.name)
    for path in (tmp_path / "cache" / "meshes").glob("*.npz"):
        path.unlink()
    after = Library(tmp_path / "cache", tmp_path / "data").mesh(entry.name)
    assert np.array_equal(before.parts[0].vertices, after.parts[0].vertices)


@pytest.mark.parametrize("damage", ["gone", "changed"])
def test_an_upload_that_was_lost_is_a_missing_asset(tmp_path, damage):
    entry = Library(tmp_path / "cache", tmp_path / "data").add_mesh(BOXES["ply"], "ply")
    for path in (tmp_path / "cache" / "meshes").glob("*.npz"):
        path.unlink()
    file = tmp_path / "data" / "assets" / entry.name.removeprefix("sha256:")
    file.unlink() if damage == "gone" else file.write_bytes(BOXES["obj"])
    with pytest.raises(JobFailure, match=f"asset-missing.*{damage}"):
        Library(tmp_path / "cache", tmp_path / "data").mesh(entry.name)
