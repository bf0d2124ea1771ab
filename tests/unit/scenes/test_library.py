"""The library: names, close matches, filters, environment maps, and an installation without assets."""

import numpy as np
import pytest

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.bundle import About, Bundle
from scene_attack.scenes.environment import average
from scene_attack.scenes.library import Library
from scene_attack.scenes.primitives import PRIMITIVES

TETRAHEDRON = b"OFF\n4 4 6\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"


@pytest.mark.parametrize(
    ("name", "match"),
    [
        ("furniture/grand-pianoo", "furniture/grand-piano"),
        ("grand-piano", "furniture/grand-piano"),
        ("primitive/spere", "primitive/sphere"),
        ("Cube", "primitive/cube"),
    ],
)
def test_an_unknown_mesh_gets_close_matches(library, name, match):
    with pytest.raises(InvalidRequest) as error:
        library.mesh(name)
    assert error.value.field == "mesh"
    assert repr(name) in error.value.detail
    assert repr(match) in error.value.detail


@pytest.mark.parametrize("name", ["", "/", "furniture/", "../../etc/passwd", "sha256:../x", "%00"])
def test_other_names_are_unknown(library, name):
    with pytest.raises(InvalidRequest, match="there is no mesh"):
        library.mesh(name)


@pytest.mark.parametrize("name", ["torus.obj", "sha256:1234", "sha256:" + "0" * 64])
def test_a_name_that_is_close_to_none_is_answered_by_how_meshes_are_named(library, name):
    with pytest.raises(InvalidRequest, match=r"there is no mesh .*; a mesh is furniture/<slug>, primitive/<name>, or"):
        library.mesh(name)


def test_without_the_catalogue_it_says_what_to_run(tmp_path):
    bare = Library(tmp_path / "cache", tmp_path / "data")
    with pytest.raises(InvalidRequest, match=r"there is no furniture in .*scripts/setup"):
        bare.mesh("furniture/grand-piano")
    with pytest.raises(InvalidRequest, match=r"no environment map 'studio'.*scripts/setup"):
        bare.environment("studio")
    assert {entry.kind for entry in bare.entries()} == {"primitive"}
    assert [entry.name for entry in bare.environments()] == ["uniform"]
    assert bare.mesh("primitive/cube").triangles == 12


def test_filters(library):
    def names(**filters):
        return {entry.name for entry in library.entries(**filters)}

    everything = names()
    assert names(category="primitive") == {f"primitive/{name}" for name in PRIMITIVES}
    assert names(search="GRAND piano") == {"furniture/grand-piano"}
    assert names(creator="scopia")
    assert len(names(creator="scopia") & names(creator="Reallusion")) == 0
    assert names(licence="cc0 1.0", search="piano") == {"furniture/grand-piano", "furniture/piano-bench"}
    assert names(search="no such thing") == set()
    assert len(everything) == len(library.entries()), "names are unique"
    assert "furniture/grand-piano" in everything


def test_the_same_mesh_is_loaded_once(library):
    assert library.mesh("primitive/sphere") is library.mesh("primitive/sphere")


def test_environment_maps(library):
    names = [entry.name for entry in library.environments()]
    assert names == ["city", "courtyard", "forest", "interior", "night", "studio", "sunrise", "sunset", "uniform"]
    for entry in library.environments():
        assert entry.licence == "CC0 1.0"
        light = library.environment(entry.name)
        assert light.radiance.dtype == np.float32
        assert np.isfinite(light.radiance).all()
        assert light.radiance.min() >= 0
        assert light.radiance.max() > 0
        if entry.name != "uniform":
            assert light.radiance.shape == (512, 1024, 3)
            assert light.credit is not None
            assert "Greg Zaal" in light.credit


def test_the_sky_is_up(library):
    small = average(library.environment("courtyard").radiance, 2, 1)
    assert small[0].mean() > 1.5 * small[1].mean()


def test_an_unknown_map_gets_close_matches(library):
    with pytest.raises(InvalidRequest) as error:
        library.environment("studo")
    assert error.value.field == "environment"
    assert "'studio'" in error.value.detail
    with pytest.raises(InvalidRequest):
        library.environment("../environments/studio")


def test_an_upload_is_seen_by_another_library(tmp_path):
    one, other = (Library(tmp_path / "cache", tmp_path / "data") for _ in range(2))
    entry = one.add_mesh(TETRAHEDRON, "off")
    assert entry.kind == "upload"
    assert entry.triangles == 4
    assert entry in other.entries()
    assert other.mesh(entry.name).triangles == 4
    assert other.mesh(entry.name).sha256 == entry.name.removeprefix("sha256:")


def test_people_s_titles_of_uploads(tmp_path):
    library = Library(tmp_path / "cache", tmp_path / "data")
    vase = library.add(Bundle("off", TETRAHEDRON, {}, About(title="vase"))).name
    plain = library.add_mesh(TETRAHEDRON + b"\n", "off").name
    assert library.titles([vase, plain, "primitive/sphere", "sha256:" + 64 * "0"]) == {vase: "vase"}


def test_a_list_has_the_uploads_that_may_be_seen_and_no_other(tmp_path):
    library = Library(tmp_path / "cache", tmp_path / "data")
    mine, another = (library.add_mesh(TETRAHEDRON + end, "off") for end in (b"", b"\n"))
    assert {mine, another} < set(library.entries())
    assert library.entries(category="upload", may_see={mine.name}.__contains__) == [mine]


def test_entries_of_the_furniture_are_made_once(library):
    first, again = ([one for one in library.entries() if one.kind != "upload"] for _ in range(2))
    assert len(first) > 100
    assert all(one is other for one, other in zip(first, again, strict=True))
