import hashlib
import os
from pathlib import Path

import pytest

from scene_attack.blobs import blobs
from scene_attack_service.jobs.files import ArtifactStore, Damaged

pytestmark = pytest.mark.slow


@pytest.fixture(params=["folder", "S3"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Path | str:
    return tmp_path / "data" if request.param == "folder" else str(request.getfixturevalue("s3_url"))


def test_files_are_kept_under_the_hash_of_their_bytes_once(place: Path | str, tmp_path: Path) -> None:
    store = ArtifactStore(place)
    for name in ("a", "b"):
        (tmp_path / name).write_bytes(b"same bytes")
        stored = store.put(tmp_path / name)
        assert stored.sha256 == hashlib.sha256(b"same bytes").hexdigest()
        assert stored.size == 10
    assert blobs(place, "artifacts").names() == [f"{stored.sha256[:2]}/{stored.sha256}"]
    with ArtifactStore(place).open(stored.sha256) as file:
        assert file.read() == b"same bytes"


@pytest.mark.parametrize("now", [b"same byteS", b"same byte", b"same bytes ", b""])
def test_other_bytes_are_never_given_out(place: Path | str, tmp_path: Path, now: bytes) -> None:
    (tmp_path / "a").write_bytes(b"same bytes")
    sha256 = ArtifactStore(place).put(tmp_path / "a").sha256
    blobs(place, "artifacts").write(f"{sha256[:2]}/{sha256}", now)
    with pytest.raises(Damaged, match=sha256):
        ArtifactStore(place).open(sha256)


def test_a_file_that_is_gone_is_not_found(place: Path | str) -> None:
    with pytest.raises(FileNotFoundError):
        ArtifactStore(place).open("0" * 64)


def test_a_file_that_could_not_be_written_whole_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = ArtifactStore(tmp_path)
    (tmp_path / "a").write_bytes(b"bytes")

    def full(_: int) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="no space"):
        store.put(tmp_path / "a")
    assert [file for file in (tmp_path / "artifacts").rglob("*") if file.is_file()] == []


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("result.json", "application/json"),
        ("attacked.png", "image/png"),
        ("perturbation.safetensors", "application/octet-stream"),
        ("page.html", "application/octet-stream"),
    ],
)
def test_media_types(tmp_path: Path, name: str, kind: str) -> None:
    (tmp_path / name).write_bytes(b"")
    assert ArtifactStore(tmp_path).put(tmp_path / name).media_type == kind
