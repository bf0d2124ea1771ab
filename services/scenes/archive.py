"""Unpacks zip files that are not trusted, in memory and in a confined process (`services.scenes.reading_process`)."""

import stat
import zipfile
import zlib
from io import BytesIO

from services.errors import InvalidRequest
from services.scenes.bundle import MAX_FILES, clean_name

SIGNATURE = b"PK\x03\x04"
MAX_RATIO = 100
"""Largest ratio of the bytes that an archive holds to its own, beyond SMALL bytes. Text compresses to a tenth."""
SMALL = 2**20
_ENCRYPTED = 1
_IGNORED = ("__MACOSX/", ".DS_Store", "Thumbs.db")
"""What file managers add."""


def unpack_archive(data: bytes, most: int) -> dict[str, bytes]:
    """Returns the files of a zip file by name, which is a relative path.

    Raises InvalidRequest("file", …), which names the entry, for archives that are damaged or encrypted, with more than
    MAX_FILES entries or `most` bytes, that unpack to MAX_RATIO times their size, with links or special files, two
    files of a name, or a name that points outside.
    """
    try:
        with zipfile.ZipFile(BytesIO(data)) as archive:
            entries = _checked(archive.infolist(), len(data), most)
            return {name: archive.read(entry) for name, entry in entries.items()}
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError, OSError) as error:
        if isinstance(error, InvalidRequest):
            raise
        # Only the words of the zip reader itself are about the file.
        said = f"damaged: {str(error)[:200]}" if isinstance(error, zipfile.BadZipFile) else "damaged, or cut off"
        raise InvalidRequest("file", f"the zip file is {said}") from error


def _checked(entries: list[zipfile.ZipInfo], packed: int, most: int) -> dict[str, zipfile.ZipInfo]:
    if len(entries) > MAX_FILES:
        raise InvalidRequest("file", f"the zip file has {len(entries):,} entries; at most {MAX_FILES:,} are taken")
    total = sum(entry.file_size for entry in entries)
    if total > most:
        raise InvalidRequest("file", f"the zip file unpacks to {total:,} bytes; at most {most:,} are taken")
    if total > max(SMALL, MAX_RATIO * packed):
        raise InvalidRequest("file", f"the zip file of {packed:,} bytes unpacks to {total:,}, which is no mesh's ratio")
    found: dict[str, zipfile.ZipInfo] = {}
    seen: set[str] = set()
    for entry in entries:
        name = clean_name(entry.filename)
        form = stat.S_IFMT(entry.external_attr >> 16)
        if form not in (0, stat.S_IFREG, stat.S_IFDIR):
            raise InvalidRequest("file", f"{entry.filename!r} in the zip file is a link or a device, and no file")
        if entry.flag_bits & _ENCRYPTED:
            raise InvalidRequest("file", f"{entry.filename!r} in the zip file is encrypted")
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise InvalidRequest("file", f"{entry.filename!r} in the zip file is compressed, but not by deflate")
        if entry.is_dir() or name.startswith(_IGNORED) or name.endswith(_IGNORED):
            continue
        if name.lower() in seen:
            raise InvalidRequest("file", f"the zip file has two files {name!r}")
        seen.add(name.lower())
        found[name] = entry
    return found
