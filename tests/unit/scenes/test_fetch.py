"""`assets fetch`: which files are taken, from packages and folders, and what is said of those that are not there."""

import hashlib
import io
import os
import tarfile
from pathlib import Path

import pytest

from scene_attack.errors import InvalidRequest, JobFailure
from scene_attack.scenes import fetch as fetching
from scene_attack.scenes.fetch import fetch, missing
from scene_attack_service.settings import Settings

CONTENT = {"environments/studio.exr": b"a map", "furniture/Scopia.sh3f": b"models"}


@pytest.fixture(autouse=True)
def expected(monkeypatch):
    digests = {hashlib.sha256(data).hexdigest(): name for name, data in CONTENT.items()}
    monkeypatch.setattr(fetching, "_expected", lambda: digests)


def package(path: Path, files: dict[str, bytes], kind: str = "xz") -> Path:
    """A Debian package, which is an archive of `ar`, with these files."""
    tar = io.BytesIO()
    with tarfile.open(fileobj=tar, mode=f"w:{kind}") as archive:
        for name, data in files.items():
            member = tarfile.TarInfo(f"./usr/share/{name}")
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    parts = {"debian-binary": b"2.0", "control.tar.xz": b"odd", f"data.tar.{kind}": tar.getvalue()}
    text = b"!<arch>\n"
    for name, data in parts.items():
        text += f"{name:<16}{0:<12}{0:<6}{0:<6}{644:<8}{len(data):<10}`\n".encode() + data + b"\n" * (len(data) % 2)
    path.write_bytes(text)
    return path


def held(cache: Path) -> dict[str, bytes]:
    files = (path for folder in ("environments", "furniture") for path in (cache / folder).glob("*"))
    return {str(path.relative_to(cache)): path.read_bytes() for path in files}


@pytest.mark.parametrize("kind", ["xz", "gz"])
def test_the_files_of_packages_are_brought_and_no_others(tmp_path, kind):
    files = {f"elsewhere/{Path(name).name}": data for name, data in CONTENT.items()} | {"other.exr": b"another map"}
    given = package(tmp_path / "a.deb", files, kind)
    assert fetch(tmp_path / "cache", [given], print) == list(CONTENT)
    assert held(tmp_path / "cache") == CONTENT
    assert fetch(tmp_path / "cache", [tmp_path / "never looked at"], print) == []


def test_a_folder_may_hold_packages_and_the_files_themselves(tmp_path):
    (tmp_path / "given" / "deep").mkdir(parents=True)
    package(tmp_path / "given" / "deep" / "a.deb", {"Scopia.sh3f": CONTENT["furniture/Scopia.sh3f"]})
    (tmp_path / "given" / "studio.exr").write_bytes(CONTENT["environments/studio.exr"])
    fetch(tmp_path / "cache", [tmp_path / "given"], print)
    assert held(tmp_path / "cache") == CONTENT


def test_a_damaged_file_is_replaced_and_a_second_run_brings_what_the_first_did_not(tmp_path):
    first = package(tmp_path / "a.deb", {"studio.exr": CONTENT["environments/studio.exr"], "Scopia.sh3f": b"changed"})
    with pytest.raises(InvalidRequest, match=r"--from: furniture/Scopia.sh3f could not be found.*SHA-256"):
        fetch(tmp_path / "cache", [first], print)
    assert held(tmp_path / "cache") == {"environments/studio.exr": CONTENT["environments/studio.exr"]}
    (tmp_path / "cache" / "furniture").mkdir()
    (tmp_path / "cache" / "furniture" / "Scopia.sh3f").write_bytes(b"cut off")
    second = package(tmp_path / "b.deb", {"Scopia.sh3f": CONTENT["furniture/Scopia.sh3f"]})
    assert fetch(tmp_path / "cache", [second], print) == ["furniture/Scopia.sh3f"]
    assert missing(tmp_path / "cache") == []


@pytest.mark.parametrize("data", [None, b"", b"no package", b"!<arch>\n", b"!<arch>\n" + 70 * b"x"])
def test_what_is_no_package_is_refused(tmp_path, data):
    path = tmp_path / "a.deb"
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(InvalidRequest, match=r"--from: .*a\.deb"):
        fetch(tmp_path / "cache", [path], print)


def test_without_apt_it_says_what_to_give(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InvalidRequest, match=r"--from: there is no apt-get here; give .* sweethome3d-furniture and"):
        fetch(tmp_path / "cache", [], print)


APT = """#!/bin/sh
case "$*" in
*update*) exit 0 ;;
*download*) cp "$PACKAGES/${@: -1}.deb" . || { echo "E: Unable to fetch ${@: -1}"; exit 100; } ;;
esac
"""


@pytest.fixture
def apt(tmp_path, monkeypatch):
    """An apt-get that copies packages from a folder, which it returns."""
    program = tmp_path / "bin" / "apt-get"
    program.parent.mkdir()
    program.write_text(APT.replace("#!/bin/sh", "#!/bin/bash"))
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")
    monkeypatch.setenv("PACKAGES", str(tmp_path))
    return tmp_path


def test_apt_downloads_the_packages_of_what_is_missing(apt, tmp_path):
    package(apt / "blender-data.deb", {"studio.exr": CONTENT["environments/studio.exr"]})
    with pytest.raises(JobFailure, match=r"cannot download sweethome3d-furniture: E: Unable to fetch"):
        fetch(tmp_path / "cache", [], print)
    package(apt / "sweethome3d-furniture.deb", {"Scopia.sh3f": CONTENT["furniture/Scopia.sh3f"]})
    assert fetch(tmp_path / "cache", [], print) == ["furniture/Scopia.sh3f"]
    assert held(tmp_path / "cache") == CONTENT
    assert not list((tmp_path / "cache").glob("incoming.*"))


def test_the_cache_of_these_tests_is_complete(monkeypatch):
    monkeypatch.undo()
    assert missing(Settings().cache_dir) == []
