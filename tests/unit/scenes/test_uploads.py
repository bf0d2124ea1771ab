"""Uploaded meshes in the library: limits from the settings, storage by content hash, and lost files."""

import hashlib
import json

import numpy as np
import pytest

from scene_attack.errors import InvalidRequest, JobFailure
from scene_attack.scenes import bundle, uploads
from scene_attack.scenes.library import Library
from scene_attack_service.settings import Settings
from tests.unit.scenes.mesh_files import ASCII_STL, BOXES
from tests.unit.scenes.scene_files import Room

pytestmark = pytest.mark.slow


def test_the_limits_of_uploads_are_those_of_the_settings(tmp_path):
    library = Library(tmp_path / "cache", tmp_path / "data")
    with pytest.raises(InvalidRequest, match=r"file: it has .* bytes; at most"):
        library.add_mesh(BOXES["obj"], "obj", Settings(max_upload_bytes=len(BOXES["obj"]) - 1))
    with pytest.raises(InvalidRequest, match="at most 11"):
        library.add_mesh(BOXES["obj"], "obj", Settings(max_faces=11))
    assert not (tmp_path / "data" / "assets").exists(), "nothing is kept of what was refused"


def test_an_upload_is_stored_once_under_the_hash_of_kind_parser_and_bytes(tmp_path):
    library = Library(tmp_path / "cache", tmp_path / "data")
    first, second = library.add_mesh(BOXES["stl"], "stl"), library.add_mesh(BOXES["stl"], "stl")
    assert first == second
    assets = tmp_path / "data" / "assets"
    digest = hashlib.sha256(b"stl 2\n" + BOXES["stl"]).hexdigest()
    assert first.name == f"sha256:{digest}"
    assert sorted(path.name for path in assets.iterdir()) == [digest, f"{digest}.json", f"{digest}.npz"]
    assert (assets / digest).read_bytes() == BOXES["stl"]
    assert json.loads((assets / f"{digest}.json").read_bytes()) == {
        "sha256": digest,
        "kind": "stl",
        "parser": 2,
        "mesh_sha256": hashlib.sha256((assets / f"{digest}.npz").read_bytes()).hexdigest(),
        "size": len(BOXES["stl"]),
        "triangles": 12,
        "about": {"title": None, "up": None, "licence": None, "credit": None},
        "used": [],
        "notes": [],
    }
    assert library.mesh(first.name).sha256 == digest


def test_the_same_bytes_as_two_kinds_are_two_meshes(tmp_path):
    """Each format passes over the lines of the other."""
    data = b"solid v\nv 0 0 0\nv 9 0 0\nv 0 1 0\nf 1 2 3\n" + ASCII_STL.partition(b"\n")[2]
    library = Library(tmp_path / "cache", tmp_path / "data")
    first = library.add_mesh(data, "obj")
    triangles = library.mesh(first.name).triangles
    second = library.add_mesh(data, "stl")
    assert first.name != second.name
    assert (triangles, library.mesh(second.name).triangles) == (1, 12)
    again = Library(tmp_path / "cache", tmp_path / "data")
    assert (again.mesh(first.name).triangles, again.mesh(second.name).triangles) == (1, 12)
    assert again.mesh(first.name).sha256 != again.mesh(second.name).sha256, "which scenes' fingerprints are made of"


def test_a_later_parser_makes_other_names_and_leaves_the_meshes_of_old_ones(tmp_path, monkeypatch):
    library = Library(tmp_path / "cache", tmp_path / "data")
    first = library.add_mesh(BOXES["obj"], "obj")
    for module in (bundle, uploads):
        monkeypatch.setattr(module, "PARSER", 3)
    for path in (tmp_path / "cache" / "meshes").glob("*.npz"):
        path.unlink()
    monkeypatch.setattr(uploads, "reader", lambda: pytest.fail("it was parsed again"))
    later = Library(tmp_path / "cache", tmp_path / "data")
    assert later.mesh(first.name).triangles == 12
    monkeypatch.undo()
    for module in (bundle, uploads):
        monkeypatch.setattr(module, "PARSER", 3)
    second = later.add_mesh(BOXES["obj"], "obj")
    assert second.name != first.name
    assert {entry.name for entry in later.entries(category="upload")} == {first.name, second.name}


def test_a_file_that_names_others_is_taken_and_said_to_lack_them(tmp_path):
    library = Library(tmp_path / "cache", tmp_path / "data")
    entry = library.add_mesh(b"# by hand\nmtllib my torus.mtl \r\n" + BOXES["obj"], "obj")
    assert entry.notes == ("material library my torus.mtl missing",)
    assert library.entries(category="upload") == [entry]


def test_a_deleted_processed_mesh_is_made_again(tmp_path):
    entry = Library(tmp_path / "cache", tmp_path / "data").add_mesh(BOXES["ply"], "ply")
    before = Library(tmp_path / "cache", tmp_path / "data").mesh(entry.name)
    for path in (tmp_path / "cache" / "meshes").glob("*.npz"):
        path.unlink()
    after = Library(tmp_path / "cache", tmp_path / "data").mesh(entry.name)
    assert np.array_equal(before.parts[0].vertices, after.parts[0].vertices)


def test_another_machine_has_the_same_uploads(tmp_path, s3_url):
    entry = Library(tmp_path / "one", s3_url).add_mesh(BOXES["ply"], "ply")
    here, there = Library(tmp_path / "one", s3_url), Library(tmp_path / "other", s3_url)
    assert there.entries(category="upload") == [entry]
    assert np.array_equal(here.mesh(entry.name).parts[0].vertices, there.mesh(entry.name).parts[0].vertices)


@pytest.mark.parametrize("damage", ["gone", "changed"])
def test_an_upload_that_was_lost_is_a_missing_asset(tmp_path, damage):
    library, assets = Library(tmp_path / "cache", tmp_path / "data"), tmp_path / "data" / "assets"
    name = library.add_mesh(BOXES["ply"], "ply").name
    for path in (tmp_path / "cache").glob("meshes/*.npz"):
        path.unlink()
    file = assets / f"{name.removeprefix('sha256:')}.npz"
    file.unlink() if damage == "gone" else file.write_bytes(BOXES["obj"])
    with pytest.raises(JobFailure, match=f"asset-missing.*{damage}"):
        library.mesh(name)


def test_a_scene_that_was_stored_before_scenes_were_read_is_read_when_it_is_added_again(tmp_path):
    library = Library(tmp_path / "cache", tmp_path / "data")
    name = library.add_mesh(Room().glb, "glb").name
    mesh, scene = library.mesh(name), library.scene(name)
    place = tmp_path / "data" / "assets" / f"{name.removeprefix('sha256:')}.json"
    record = json.loads(place.read_text())
    del record["scene_sha256"]
    place.write_text(json.dumps(record))
    with pytest.raises(InvalidRequest, match="file: it was added by a version that read no scenes; add it again"):
        library.scene(name)
    assert library.add_mesh(Room().glb, "glb").name == name
    assert library.scene(name) == scene
    assert np.array_equal(library.mesh(name).parts[0].vertices, mesh.parts[0].vertices)


def test_a_scene_that_was_changed_where_it_is_kept_is_noticed(tmp_path):
    library = Library(tmp_path / "cache", tmp_path / "data")
    name = library.add_mesh(Room().glb, "glb").name
    place = tmp_path / "data" / "assets" / f"{name.removeprefix('sha256:')}.scene"
    place.write_bytes(place.read_bytes().replace(b"Ball", b"Bill"))
    with pytest.raises(JobFailure, match="has changed where it is kept"):
        library.scene(name)
    library.remove_upload(name)
    assert not list((tmp_path / "data" / "assets").iterdir())
