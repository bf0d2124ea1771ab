"""Zip files that are not trusted."""

import io
import stat
import zipfile

import pytest

from services.errors import InvalidRequest
from services.scenes.bundle import unpack_archive
from services.scenes.reading.isolated import reader

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
