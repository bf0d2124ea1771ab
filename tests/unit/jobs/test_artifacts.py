import hashlib
import os
from pathlib import Path

import pytest

from services.jobs.artifacts import ArtifactStore, media_type


def test_files_lie_under_the_hash_of_their_bytes_once(tmp_path: Path) -> None:
    store = ArtifactStore(tmp_path / "artifacts")
    for name in ("a", "b"):
        (tmp_path / name).write_bytes(b"same bytes")
        stored = store.put(tmp_path / name)
        assert stored.sha256 == hashlib.sha256(b"same bytes").hexdigest()
        assert stored.size == 10
    path = tmp_path / "artifacts" / stored.sha256[:2] / stored.sha256
    assert store.path(stored.sha256) == path
    assert [file for file in (tmp_path / "artifacts").rglob("*") if file.is_file()] == [path]
    assert path.read_bytes() == b"same bytes"


def test_a_file_that_could_not_be_written_whole_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = ArtifactStore(tmp_path / "artifacts")
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
def test_media_types(name: str, kind: str) -> None:
    assert media_type(name) == kind
