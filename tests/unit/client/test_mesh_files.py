"""The files that are sent with a mesh: those beside it that it names, and no others of this machine."""

from pathlib import Path

import pytest

from scene_attack.client.mesh_files import with_files_beside
from scene_attack.errors import InvalidRequest
from tests.unit.scenes.test_companion_files import MTL, OBJ, image


def sent(*given: Path) -> list[str]:
    return sorted(name for name, _ in with_files_beside(given))


def test_what_a_mesh_and_its_materials_name_is_sent(tmp_path: Path) -> None:
    (tmp_path / "tex").mkdir()
    for name, data in {"chair.obj": OBJ, "My Chair.mtl": MTL, "tex/wood.png": image(), "capsule0.jpg": image()}.items():
        (tmp_path / name).write_bytes(data)
    (tmp_path / "unnamed.png").write_bytes(image())
    assert sent(tmp_path / "chair.obj") == ["My Chair.mtl", "capsule0.jpg", "chair.obj", "tex/wood.png"]
    assert sent(tmp_path / "chair.obj", tmp_path / "unnamed.png")[-1] == "unnamed.png"


def test_files_elsewhere_and_of_other_kinds_are_not_sent(tmp_path: Path) -> None:
    folder = tmp_path / "mesh"
    folder.mkdir()
    (tmp_path / "secret.png").write_bytes(image())
    (tmp_path / "key.mtl").write_bytes(b"secret")
    (folder / "id_rsa").write_bytes(b"secret")
    (folder / "link.png").symlink_to(tmp_path / "secret.png")
    names = [b"../key.mtl", b"/etc/passwd", str(tmp_path / "key.mtl").encode(), b"id_rsa", b"a.mtl"]
    (folder / "a.obj").write_bytes(b"".join(b"mtllib " + name + b"\n" for name in names) + OBJ)
    (folder / "a.mtl").write_bytes(b"newmtl a\nmap_Kd ../secret.png\nnewmtl b\nmap_Kd link.png\n")
    assert sent(folder / "a.obj") == ["a.mtl", "a.obj"]


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match=r"FILE: there is no file .*chair.obj"):
        with_files_beside([tmp_path / "chair.obj"])
