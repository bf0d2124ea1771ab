import os
from pathlib import Path

import numpy as np

from scene_attack.scenes.mesh import Part
from scene_attack.scenes.store import limit, load_parts, save_parts

PART = Part(
    vertices=np.eye(3, dtype=np.float32),
    normals=np.eye(3, dtype=np.float32),
    faces=np.array([[0, 1, 2]]),
)


def test_the_meshes_that_were_not_used_for_longest_go(tmp_path: Path) -> None:
    files = [tmp_path / f"{name}.npz" for name in "abc"]
    for age, file in enumerate(files):
        save_parts(file, (PART,))
        os.utime(file, (1000 + age, 1000 + age))
    (tmp_path / "other.json").write_text("{}")
    assert load_parts(files[0]) is not None  # used again: now the youngest
    size = files[0].stat().st_size
    limit(tmp_path, 3 * size)
    assert all(file.exists() for file in files)
    limit(tmp_path, 2 * size)
    assert [file.exists() for file in files] == [True, False, True]
    limit(tmp_path, 0)
    assert [path.name for path in tmp_path.iterdir()] == ["other.json"]
    limit(tmp_path / "there is no such folder", 0)
