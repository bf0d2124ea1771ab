"""Files by name, in a folder and in an object store alike."""

import errno
from pathlib import Path

import pytest

from scene_attack import blobs as module
from scene_attack.blobs import Blobs, blobs
from scene_attack.errors import InvalidRequest

pytestmark = pytest.mark.slow


@pytest.fixture(params=["folder", "file URL", "S3"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Path | str:
    if request.param == "folder":
        return tmp_path
    return f"file://{tmp_path}" if request.param == "file URL" else str(request.getfixturevalue("s3_url"))


@pytest.fixture
def files(place: Path | str) -> Blobs:
    return blobs(place, "part")


def test_what_is_written_is_read_also_elsewhere(files: Blobs, place: Path | str) -> None:
    assert files.names() == []
    assert not files.exists("ab/c")
    files.write("ab/c", b"bytes")
    files.write("d", b"")
    other = blobs(place, "part")
    assert other.exists("ab/c")
    assert other.names() == ["ab/c", "d"]
    with other.open("ab/c") as file:
        assert file.read() == b"bytes"
        file.seek(2)
        assert file.read() == b"tes"
    assert blobs(place, "other").names() == []


def test_a_file_that_is_not_there_is_not_found(files: Blobs) -> None:
    with pytest.raises(FileNotFoundError):
        files.open("none")


def test_another_listing_sees_what_was_written_since(files: Blobs, place: Path | str) -> None:
    other = blobs(place, "part")
    assert other.names() == []
    files.write("a", b"")
    assert other.names() == ["a"]


@pytest.mark.usefixtures("s3_server")
def test_a_store_that_takes_nothing_is_an_error_of_input_and_output() -> None:
    missing = blobs("s3://no-such-bucket/folder", "part")
    with pytest.raises(OSError, match="does not answer") as error:
        missing.write("a", b"")
    assert error.value.errno == errno.EREMOTEIO


@pytest.mark.parametrize("url", ["bucket/folder", "file://relative", "nosuch://a/b"])
def test_a_url_of_no_store_is_bad_input(url: str) -> None:
    with pytest.raises(InvalidRequest, match="s3") as error:
        blobs(url, "part")
    assert error.value.field == "SCENE_ATTACK_ARTIFACT_URL"


def test_a_file_is_deleted_at_once(files: Blobs) -> None:
    files.delete("a/b")  # there is none
    files.write("a/b", b"1")
    files.delete("a/b")
    assert files.names() == []


def test_a_file_is_removed_unless_it_is_wanted(files: Blobs, place: Path | str) -> None:
    assert not files.keep("a/b")
    files.remove("a/b", 0.0)  # there is none
    files.write("a/b", b"1")
    assert files.keep("a/b")
    files.remove("a/b", 3600.0)
    assert files.names() == ["a/b"]
    files.remove("a/b", 0.0)
    in_a_folder = isinstance(place, Path) or place.startswith("file:")
    assert files.names() == ([] if in_a_folder else ["a/b"])  # an object is kept while it is young


def test_an_old_object_is_removed_and_written_again_if_it_is_wanted(
    s3_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "YOUNG_SECONDS", 0.0)
    files = blobs(s3_url, "part")
    files.write("a/b", b"1")
    assert not files.keep("a/b")
    files.remove("a/b", 0.0)
    assert files.names() == []


def test_a_file_is_replaced_and_deleted_at_once(files: Blobs) -> None:
    files.delete("a/b")  # there is none
    files.write("a/b", b"1")
    files.write("a/b", b"22")
    with files.open("a/b") as file:
        assert file.read() == b"22"
    files.delete("a/b")
    assert files.names() == []
