"""Meshes that come with other files: their names, which of them is the mesh, the hash of all; zip files of others."""

import io
import stat
import zipfile

import pytest

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.bundle import Bundle, bundle_of, clean_name, unpack_archive
from scene_attack.scenes.reading.isolated import reader
from tests.unit.scenes.mesh_files import BOXES

OBJ = BOXES["obj"]


@pytest.mark.parametrize(
    ("name", "clean"), [("a.obj", "a.obj"), ("m\\tex\\a.png", "m/tex/a.png"), ("./m//a b.mtl", "m/a b.mtl")]
)
def test_a_name_is_a_relative_path(name, clean):
    assert clean_name(name) == clean


@pytest.mark.parametrize(
    "name", ["", ".", "../a.obj", "m/../../a.obj", "/etc/passwd", "C:\\a.obj", "a\0b", "a\nb", "x" * 256, "\\\\host\\a"]
)
def test_a_name_that_points_outside_or_is_none_is_refused(name):
    with pytest.raises(InvalidRequest) as error:
        clean_name(name)
    assert error.value.field == "file"
    assert name == "" or repr(name[:5])[1:-1] in error.value.detail


def test_the_only_mesh_is_the_mesh_and_its_files_are_named_from_its_folder():
    files = {"m/a.obj": OBJ, "m/a.mtl": b"newmtl x", "tex/w.png": b"png", "m/readme.txt": b"hello"}
    bundle = bundle_of(files)
    assert (bundle.kind, bundle.data) == ("obj", OBJ)
    assert bundle.others == {"a.mtl": b"newmtl x", "../tex/w.png": b"png"}
    assert bundle.size == len(OBJ) + 8 + 3


def test_of_several_meshes_one_must_be_named():
    files = {"a.obj": OBJ, "b/c.glb": BOXES["glb"]}
    with pytest.raises(InvalidRequest, match=r"mesh: there are 2 meshes, 'a.obj', 'b/c.glb': name one .*--mesh"):
        bundle_of(files)
    assert bundle_of(files, mesh="c.glb").kind == "glb"
    assert bundle_of(files, mesh="b/c.glb").kind == "glb"
    assert bundle_of(files, kind="obj").data == OBJ
    with pytest.raises(InvalidRequest, match=r"mesh: there is no mesh 'd.obj' among the files; the meshes are 'a.obj'"):
        bundle_of(files, mesh="d.obj")
    with pytest.raises(InvalidRequest, match="whole path"):
        bundle_of({"x/a.obj": OBJ, "y/a.obj": OBJ}, mesh="a.obj")


def test_files_without_a_mesh_are_refused():
    with pytest.raises(InvalidRequest, match=r"file: there is no mesh among the 2 files; a mesh ends in .obj, "):
        bundle_of({"a.png": b"", "b.mtl": b""})
    with pytest.raises(InvalidRequest, match="kind: the name 'mesh'"):
        bundle_of({"mesh": b""})
    with pytest.raises(InvalidRequest, match="kind: 'fbx' is not read; one of obj"):
        bundle_of({"a.fbx": b""}, kind="fbx")


def test_the_hash_covers_kind_names_and_bytes_of_all_files():
    files = {"a.mtl": b"1", "b.png": b"2"}
    known = Bundle("obj", OBJ, files).sha256
    for other in (
        Bundle("obj", OBJ, {}),
        Bundle("ply", OBJ, files),
        Bundle("obj", OBJ + b"\n", files),
        Bundle("obj", OBJ, {"a.mtl": b"1", "b.png": b"3"}),
        Bundle("obj", OBJ, {"a.mtl": b"1", "c.png": b"2"}),
        Bundle("obj", OBJ, {"a.mtl": b'1\n"b.png" 1\n2'}),
    ):
        assert other.sha256 != known
    assert Bundle("obj", OBJ, {"b.png": b"2", "a.mtl": b"1"}).sha256 == known


def test_what_is_kept_holds_every_byte_and_is_always_the_same():
    bundle = Bundle("obj", OBJ, {"b.png": b"2", "../a.mtl": b"1"})
    assert bundle.stored() == Bundle("obj", OBJ, {"../a.mtl": b"1", "b.png": b"2"}).stored()
    with zipfile.ZipFile(io.BytesIO(bundle.stored())) as archive:
        assert [archive.read(name) for name in archive.namelist()] == [OBJ, b"1", b"2"]
        assert archive.namelist() == ["mesh/mesh.obj", "a.mtl", "mesh/b.png"]
    assert Bundle("obj", OBJ, {}).stored() == OBJ


MOST = 2**22


def zipped(*files, compression=zipfile.ZIP_DEFLATED):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        for name, data in files:
            archive.writestr(name, data)
    return buffer.getvalue()


def special(kind):
    info = zipfile.ZipInfo("m/a.png")
    info.external_attr = (kind | 0o777) << 16
    return zipped((info, b"/etc/passwd"))


def encrypted():
    data = bytearray(zipped(("a.obj", b"v 0 0 0")))
    for mark, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(mark) + offset] |= 1
    return bytes(data)


def lying():
    """An entry that says that it is smaller than what it unpacks to."""
    data = bytearray(zipped(("a.obj", bytes(3 * 2**20))))
    for mark, offset in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        data[data.index(mark) + offset : data.index(mark) + offset + 4] = (1_000).to_bytes(4, "little")
    return bytes(data)


def test_files_are_unpacked_by_their_paths():
    data = zipped(("m/", b""), ("m\\a.obj", b"v"), ("m/tex/w.png", b"2"), ("__MACOSX/m/._a.obj", b"x"))
    assert unpack_archive(data, MOST) == {"m/a.obj": b"v", "m/tex/w.png": b"2"}
    assert reader().unpack(data, MOST) == {"m/a.obj": b"v", "m/tex/w.png": b"2"}


def scrambled():
    """An entry whose compressed bytes are others; their check is never reached."""
    data = bytearray(zipped(("a.obj", " ".join(map(str, range(1000))))))
    data[40:400] = bytes(range(180)) * 2
    return bytes(data)


BAD = {
    "a path outside": (zipped(("../a.obj", b"v")), r"'../a.obj' points outside"),
    "an absolute path": (zipped(("/a.obj", b"v")), r"'/a.obj' points outside"),
    "a link": (special(stat.S_IFLNK), r"'m/a.png' in the zip file is a link"),
    "a device": (special(stat.S_IFCHR), r"'m/a.png' in the zip file is a link or a device"),
    "a bomb by ratio": (zipped(("a.obj", bytes(2 * 2**20))), "unpacks to 2,097,152"),
    "a bomb by size": (zipped(("a.obj", bytes(range(256)) * 2**15)), "at most 4,194,304 are taken"),
    "a bomb by entries": (zipped(*((f"{k}.png", b"") for k in range(501))), "501 entries"),
    "a lie about its size": (lying(), "damaged"),
    "encrypted": (encrypted(), "'a.obj' in the zip file is encrypted"),
    "another compression": (zipped(("a.obj", b"v" * 99), compression=zipfile.ZIP_LZMA), "not by deflate"),
    "two files of a name": (zipped(("a.obj", b"1"), ("A.OBJ", b"2")), "two files 'A.OBJ'"),
    "other compressed bytes": (scrambled(), "the zip file is damaged, or cut off$"),
    "no zip file": (b"PK\x03\x04" + bytes(50), "damaged"),
    "cut off": (zipped(("a.obj", b"v" * 99))[:-30], "damaged"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_archive_is_refused_and_says_why(case):
    data, said = BAD[case]
    for unpack in (unpack_archive, reader().unpack):
        with pytest.raises(InvalidRequest, match=said) as error:
            unpack(data, MOST)
        assert error.value.field == "file"
