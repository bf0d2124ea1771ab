"""Results that cannot be exported say why."""

import pytest

from scene_attack.errors import InvalidRequest
from scene_attack.export.bundle import read_finished
from scene_attack.scenes.library import Library


def test_a_folder_without_a_result_is_refused(tmp_path) -> None:
    with pytest.raises(InvalidRequest, match=r"there is no result\.json"):
        read_finished({}, Library(tmp_path, tmp_path))


@pytest.mark.parametrize("damaged", [b"", b"{}", b"\xff", b'{"spec": 1}'])
def test_a_damaged_result_is_refused(tmp_path, damaged: bytes) -> None:
    with pytest.raises(InvalidRequest, match="cannot be read"):
        read_finished({"result.json": lambda: damaged}, Library(tmp_path, tmp_path))
