"""Which kernels a process loads: those that the processor can run and that the setting asks for."""

from pathlib import Path

import pytest

from scene_attack.errors import InvalidRequest
from scene_attack.process import replaced
from scene_attack.rendering.kernels import levels


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of copies of the kernels, which stand for those of an installation, on a processor that runs all."""
    for level in ("v4", "v3"):
        (tmp_path / f"{level}.so").write_bytes(levels.library_path(level).read_bytes())
    monkeypatch.setattr(levels, "NEEDS", {"v4": levels.V4, "v3": levels.V3})
    monkeypatch.setattr(levels, "library_path", lambda level: tmp_path / f"{level}.so")
    monkeypatch.setattr(levels, "features", lambda: levels.V4)
    return tmp_path


@pytest.mark.usefixtures("installed")
def test_the_highest_level_is_loaded_that_the_processor_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    with replaced(kernels="auto"):
        assert levels.level() == "v4"
        monkeypatch.setattr(levels, "features", lambda: levels.V4 - {"avx512cd"})
        assert levels.level() == "v3"
        monkeypatch.setattr(levels, "features", lambda: levels.V3 - {"fma"})
        assert levels.level() is None
        assert "v4 need avx512bw, avx512cd, " in levels.why_none()
        assert "v3 need fma, which this processor lacks" in levels.why_none()


def test_a_level_that_is_not_installed_or_damaged_is_passed_over(installed: Path) -> None:
    with replaced(kernels="auto"):
        (installed / "v4.so").write_bytes(b"no library")
        assert levels.level() == "v3"
        (installed / "v3.so").unlink()
        assert levels.level() is None
        assert "v4 cannot be loaded" in levels.why_none()
        assert "v3 are not in this installation" in levels.why_none()


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize("asked", ["v3", "v4", "torch"])
def test_what_is_asked_for_is_loaded(asked: str) -> None:
    with replaced(kernels=asked):
        assert (levels.level() or "torch") == asked


def test_what_is_asked_for_and_not_there_is_refused(installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(levels, "features", lambda: levels.V3)
    with (
        replaced(kernels="v4"),
        pytest.raises(InvalidRequest, match=r"SCENE_ATTACK_KERNELS=v4: .* need avx512bw, .* lacks; use auto or torch"),
    ):
        levels.level()
    (installed / "v3.so").unlink()
    with (
        replaced(kernels="v3"),
        pytest.raises(InvalidRequest, match=r"SCENE_ATTACK_KERNELS=v3: .* not in this installation"),
    ):
        levels.level()


def test_kernels_for_another_architecture_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(levels, "NEEDS", {"baseline": frozenset()})
    with replaced(kernels="v3"), pytest.raises(InvalidRequest, match="v3 are for x86-64"):
        levels.level()
