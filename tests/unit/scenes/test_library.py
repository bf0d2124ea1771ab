"""The library: names, close matches, filters, environment maps, and an installation without assets."""

import pickle

import numpy as np
import pytest

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.bundle import About, Bundle
from scene_attack.scenes.environment import average
from scene_attack.scenes.library import PACKAGED, Library
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


MODELS = 10
MAPS = ["city", "interior", "studio", "uniform"]


def test_a_plain_installation_has_the_assets_of_the_package_and_says_how_to_get_the_others(tmp_path):
    bare = Library(tmp_path / "cache", tmp_path / "data")
    for name in ("sofa3", "grand-pianoo"):
        with pytest.raises(InvalidRequest, match=r"there is no mesh .*`scene-attack assets fetch` brings"):
            bare.mesh(f"furniture/{name}")
    with pytest.raises(InvalidRequest, match=r"no environment map 'courtyard'.*`scene-attack assets fetch` brings"):
        bare.environment("courtyard")
    assert [entry.kind for entry in bare.entries()].count("furniture") == MODELS
    assert [entry.name for entry in bare.environments()] == MAPS
    assert bare.mesh("furniture/grand-piano").triangles > 1000
    assert bare.picture("furniture/grand-piano") is not None


def test_the_assets_of_the_package_are_those_that_are_fetched(assets, tmp_path):
    packaged = Library(tmp_path / "nothing", tmp_path / "data")
    fetched = Library(assets, tmp_path / "data", packaged=False)
    for entry in packaged.entries():
        assert fetched.entry(entry.name) == entry
        assert fetched.mesh(entry.name).sha256 == packaged.mesh(entry.name).sha256
        assert fetched.picture(entry.name) == packaged.picture(entry.name)
    for name in MAPS:
        one, other = packaged.environment(name), fetched.environment(name)
        assert one.radiance.tobytes() == other.radiance.tobytes()
        assert (one.name, one.sha256, one.credit) == (other.name, other.sha256, other.credit)


def test_each_asset_of_the_package_has_its_author_and_licence_beside_it(tmp_path):
    bare = Library(tmp_path / "cache", tmp_path / "data")
    listed = (PACKAGED / "LICENCES.md").read_text("utf-8")
    for entry in [*bare.entries(), *bare.environments()]:
        if entry.creator != "scene-attack":
            assert f"| {entry.name} | {entry.title} | {entry.creator} | [{entry.licence}](https://" in listed


def test_an_export_s_library_has_nothing_of_the_package(tmp_path):
    bare = Library(tmp_path / "cache", tmp_path / "data", packaged=False)
    assert {entry.kind for entry in bare.entries()} == {"primitive"}
    assert [entry.name for entry in pickle.loads(pickle.dumps(bare)).environments()] == ["uniform"]


def test_a_radiance_picture_in_the_folder_of_maps_is_a_map(tmp_path):
    (tmp_path / "environments").mkdir()
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 4\n"
    (tmp_path / "environments" / "garden.hdr").write_bytes(head + 4 * bytes([128, 64, 0, 129]))
    garden = Library(tmp_path, tmp_path / "data").environment("garden")
    assert garden.radiance.tolist() == [4 * [[1.0, 0.5, 0.0]]]


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
