"""Results that cannot be exported say why."""

from math import nan
from pathlib import Path

import pytest
import torch
from safetensors.torch import save

from scene_attack.errors import InvalidRequest
from scene_attack.export.bundle import read_finished
from scene_attack.process import options
from scene_attack.scenes.library import Library
from tests.unit.rendering.torch.drill import attacked


def test_a_folder_without_a_result_is_refused(tmp_path) -> None:
    with pytest.raises(InvalidRequest, match=r"there is no result\.json"):
        read_finished({}, Library(tmp_path, tmp_path))


@pytest.mark.parametrize("damaged", [b"", b"{}", b"\xff", b'{"spec": 1}'])
def test_a_damaged_result_is_refused(tmp_path, damaged: bytes) -> None:
    with pytest.raises(InvalidRequest, match="cannot be read"):
        read_finished({"result.json": lambda: damaged}, Library(tmp_path, tmp_path))


def test_a_perturbation_that_is_not_finite_is_refused(tmp_path: Path) -> None:
    attacked("shape", steps=1).save(tmp_path)
    damaged = save({"shape": torch.full((1, 23, 23, 23, 3), nan)})
    files = {path.name: path.read_bytes for path in tmp_path.iterdir()} | {"perturbation.safetensors": lambda: damaged}
    used = options()
    with pytest.raises(InvalidRequest, match="not finite"):
        read_finished(files, Library(used.cache_dir, used.data_dir))
