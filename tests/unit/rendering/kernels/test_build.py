"""Kernels that were compiled before: loaded without a compiler, or refused with the reason."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from scene_attack.errors import InvalidRequest, JobFailure
from scene_attack.process import replaced
from scene_attack.rendering.kernels import build, compiled
from scene_attack.rendering.torch import table

pytestmark = [pytest.mark.slow, pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with kernels compiled for any processor of this kind."""
    found = tmp_path_factory.mktemp("kernels")
    with replaced(kernel_dir=found, kernel_arch="portable"):
        build.library_path()
    return found


@pytest.fixture
def prebuilt(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """That folder in a process that has no compiler and loads no other kernels."""
    monkeypatch.setenv("CXX", "no-such-compiler")
    compiled.library.cache_clear()
    with replaced(kernel_dir=folder, kernel_arch="portable", kernel="native"):
        yield folder
    compiled.library.cache_clear()


def test_kernels_are_loaded_without_a_compiler(prebuilt: Path) -> None:
    path, manifest = build.library_path()
    assert path.parent == prebuilt
    assert compiled.backend() == f"native {manifest.identity}"


@pytest.mark.usefixtures("prebuilt")
def test_portable_kernels_compute_what_torch_does() -> None:
    angles = torch.linspace(-5, 5, 200, dtype=torch.float32).reshape(-1, 2)
    found = table.to_vectors(angles)
    exact = table.to_vectors(angles.double())
    assert compiled.library() is not None
    torch.testing.assert_close(found.double(), exact, rtol=0, atol=2e-7)  # rounded to float32 once or twice


@pytest.mark.usefixtures("prebuilt")
def test_kernels_of_other_sources_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sources = tmp_path / "sources"
    shutil.copytree(build.SOURCES, sources)
    with (sources / "shading.cpp").open("a") as file:
        file.write("// edited\n")
    monkeypatch.setattr(build, "SOURCES", sources)
    with pytest.raises(build.KernelsMissingError, match=r"compiled from other sources.*install g\+\+"):
        build.library_path()


@pytest.mark.usefixtures("prebuilt")
def test_kernels_for_a_better_processor_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    _, manifest = build.library_path()
    lacking = build.features() - {manifest.features[-1]}
    monkeypatch.setattr(build, "features", lambda: lacking)
    with pytest.raises(JobFailure, match=f"this processor lacks {manifest.features[-1]}"):
        compiled.library()


@pytest.mark.usefixtures("prebuilt")
def test_kernels_for_another_setting_are_refused() -> None:
    with (
        replaced(kernel_arch="native"),
        pytest.raises(build.KernelsMissingError, match="other flags; SCENE_ATTACK_KERNEL_ARCH"),
    ):
        build.library_path()


@pytest.mark.usefixtures("prebuilt")
def test_no_kernels_and_no_compiler_leave_torch(tmp_path: Path) -> None:
    with replaced(kernel_dir=tmp_path, kernel="auto"):
        assert compiled.library() is None
        assert compiled.backend() == "torch"


@pytest.mark.parametrize("left", [0, 1000])
def test_a_library_cut_short_is_not_loaded(prebuilt: Path, left: int, tmp_path: Path) -> None:
    """The loader would end the process with a bus error."""
    shutil.copytree(prebuilt, tmp_path / "copy")
    [cut] = (tmp_path / "copy").glob("*.so")
    cut.write_bytes(cut.read_bytes()[:left])
    damaged = "damaged: the library is not the one that was compiled"
    with replaced(kernel_dir=tmp_path / "copy"), pytest.raises(JobFailure, match=damaged):
        compiled.library()


@pytest.mark.usefixtures("prebuilt")
def test_a_manifest_that_is_damaged_is_none(tmp_path: Path) -> None:
    path, _ = build.library_path()
    shutil.copy(path, tmp_path)
    (tmp_path / path.with_suffix(".json").name).write_text("{")
    with replaced(kernel_dir=tmp_path), pytest.raises(build.KernelsMissingError, match="no compiled kernels"):
        build.library_path()


@pytest.mark.parametrize("place", ["a file", "a file/below", "/proc/nothing"])
def test_a_folder_that_cannot_be_written_is_named(place: str, tmp_path: Path) -> None:
    """The message was "[Errno 17] File exists", and a service started with it."""
    (tmp_path / "a file").write_text("")
    words = rf"{tmp_path / place} \(SCENE_ATTACK_KERNEL_DIR\): [A-Z]"
    with replaced(kernel_dir=tmp_path / place, kernel="native"):
        with pytest.raises(build.KernelsMissingError, match=words):
            build.library_path()
        with pytest.raises(InvalidRequest, match=f"SCENE_ATTACK_KERNEL=native: .*{words}"):
            build.check_kernels()
    with replaced(kernel_dir=tmp_path / place, kernel="auto"):
        build.check_kernels()


def test_native_kernels_and_an_empty_path(prebuilt: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A compiler is needed only where there are no kernels yet."""
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX")
    build.check_kernels()
    assert compiled.library() is not None
    assert build.library_path()[0].parent == prebuilt
    missing = r"SCENE_ATTACK_KERNEL=native: .* no C\+\+ compiler; install g\+\+"
    with replaced(kernel_dir=tmp_path), pytest.raises(InvalidRequest, match=missing):
        build.check_kernels()


def test_what_compiled_code_needs_is_read_off_the_compilers_macros() -> None:
    assert build.needed("#define __AVX2__ 1\n#define __FMA__ 1\n#define __GNUC__ 12\n") == {"avx2", "fma"}
