"""Compiles the kernels and finds compiled libraries: at set-up, in the build of a container image, or at first use.

    python -m scene_attack.rendering.kernels.build

A library lies in the kernel folder beside a manifest of the sources, flags and processor it was compiled for. A process
whose sources, settings and processor match the manifest loads the library and needs no compiler.
"""

import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from functools import lru_cache
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from scene_attack.errors import InvalidRequest
from scene_attack.options import Options
from scene_attack.process import options, use

CPUINFO = Path("/proc/cpuinfo")
FEATURES_BY_MACRO = {
    "__SSE3__": "pni", "__SSSE3__": "ssse3", "__SSE4_1__": "sse4_1", "__SSE4_2__": "sse4_2", "__POPCNT__": "popcnt",
    "__AVX__": "avx", "__AVX2__": "avx2", "__FMA__": "fma", "__F16C__": "f16c", "__BMI__": "bmi1", "__BMI2__": "bmi2",
    "__LZCNT__": "abm", "__MOVBE__": "movbe", "__AVX512F__": "avx512f", "__AVX512CD__": "avx512cd",
    "__AVX512DQ__": "avx512dq", "__AVX512BW__": "avx512bw", "__AVX512VL__": "avx512vl",
    "__ARM_FEATURE_SVE": "sve", "__ARM_FEATURE_DOTPROD": "asimddp",
}  # fmt: skip
"""The /proc/cpuinfo name of each instruction set, by the compiler's predefined macro for it."""


@lru_cache(maxsize=1)
def features() -> frozenset[str]:
    """Returns the processor's features as /proc/cpuinfo names them (`flags`, or `Features` on ARM)."""
    return frozenset(_line("flags", "features").split())


@lru_cache(maxsize=1)
def identity() -> str:
    """Returns the SHA-256 (hex) of the processor's name and features.

    Code compiled for a processor may not run, or may give other bits, on a processor of another identity.
    """
    about = f"{_line('model name', 'cpu part')}\n{' '.join(sorted(features()))}"
    return hashlib.sha256(about.encode()).hexdigest()


def needed(macros: str) -> set[str]:
    """Returns the features that compiled code may use, given the compiler's predefined macros (`-dM -E`)."""
    defined = {line.split()[1] for line in macros.splitlines() if line.startswith("#define")}
    return {feature for macro, feature in FEATURES_BY_MACRO.items() if macro in defined}


def _line(*names: str) -> str:
    """Returns the value of the first line of /proc/cpuinfo with one of these names; empty if there is none."""
    for line in CPUINFO.read_text().splitlines():
        name, _, value = line.partition(":")
        if name.strip().lower() in names:
            return value.strip()
    return ""


SOURCES = Path(__file__).parent
SUFFIXES = (".cpp", ".h")
FLAGS = (
    "-O3", "-std=c++17", "-fopenmp", "-shared", "-fPIC", "-fno-math-errno", "-fno-trapping-math",
    "-Wno-maybe-uninitialized", "-Wno-ignored-attributes", "-Wno-psabi",
)  # fmt: skip
PORTABLE = {"x86_64": "x86-64-v3", "aarch64": "armv8-a"}
"""Architectures of SCENE_ATTACK_KERNEL_ARCH=portable by machine: x86-64 with AVX2 and FMA (since 2015), 64-bit ARM."""


class KernelsMissingError(OSError):
    """No compiled library suits this process, and none can be compiled; the message gives the reason."""


class Manifest(BaseModel):
    """The inputs of a compilation. Two libraries with the same manifest give the same bits."""

    model_config = ConfigDict(frozen=True)

    sources: str
    """SHA-256 of all sources (hex)."""
    machine: str
    """The value of `platform.machine()`: "x86_64" or "aarch64"."""
    flags: tuple[str, ...]
    processor: str
    """Digest of the processor's name and features if the flags compile for this very processor, else empty."""
    features: tuple[str, ...]
    """Instruction-set features that the library requires, as /proc/cpuinfo names them."""
    compiler: str
    """The compiler's version line."""
    library_sha256: str
    """SHA-256 of the library's bytes (hex): loading a damaged one would end the process."""

    @property
    def identity(self) -> str:
        """Sixteen hexadecimal digits that identify the manifest; part of every backend string."""
        return hashlib.sha256(self.model_dump_json(exclude={"library_sha256"}).encode()).hexdigest()[:16]

    def refusal(self) -> str | None:
        """Returns the reason why this process may not load the library, as a clause; None if it may."""
        if self.machine != platform.machine():
            return f"they were compiled for {self.machine}, and this is {platform.machine()}"
        if self.sources != sources_sha256():
            return "they were compiled from other sources"
        if self.flags != flags():
            return "they were compiled with other flags; SCENE_ATTACK_KERNEL_ARCH differs"
        if missing := sorted(set(self.features) - features()):
            return f"this processor lacks {', '.join(missing)}, which they were compiled to use"
        if self.processor not in ("", identity()):
            return "they were compiled for another processor; SCENE_ATTACK_KERNEL_ARCH=portable would suit both"
        return None


def library_path() -> tuple[Path, Manifest]:
    """Returns the library to load and its manifest; compiles it (about 10 s) if no suitable library exists.

    Raises KernelsMissingError if there is no compiler or the folder cannot be written, CalledProcessError if the
    compiler fails.
    """
    path = _wanted()
    manifest = _manifest(path.with_suffix(".json"))
    if manifest is not None and manifest.refusal() is None and _sha256(path) == manifest.library_sha256:
        return path, manifest
    if _compiler() is None:
        raise KernelsMissingError(f"{_why_none()}; install g++ and run scripts/setup, or set SCENE_ATTACK_KERNEL=torch")
    try:
        return path, _compile(path)
    except OSError as error:
        folder = f"{path.parent} (SCENE_ATTACK_KERNEL_DIR)"
        raise KernelsMissingError(f"they cannot be written to {folder}: {error.strerror or error}") from error


def check_kernels() -> None:
    """Finds or compiles the kernels where SCENE_ATTACK_KERNEL=native asks for them.

    Raises InvalidRequest, naming the setting, if there are none: a service would accept jobs and fail each of them.
    """
    if options().kernel != "native":
        return
    try:
        library_path()
    except (OSError, subprocess.CalledProcessError) as error:
        reason = error.stderr if isinstance(error, subprocess.CalledProcessError) else error
        raise InvalidRequest("SCENE_ATTACK_KERNEL=native", f"there are no kernels: {reason}") from error


def sources_sha256() -> str:
    """Returns the SHA-256 (hex) of the names and texts of all sources."""
    texts = [f"{path.name}\n{path.read_text()}" for path in sorted(SOURCES.iterdir()) if path.suffix in SUFFIXES]
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()


def flags() -> tuple[str, ...]:
    """Returns the compiler's flags for SCENE_ATTACK_KERNEL_ARCH on this machine."""
    arch, machine = options().kernel_arch, platform.machine()
    if arch == "portable":
        arch = PORTABLE.get(machine, "")
    if machine != "x86_64":
        return (*FLAGS, f"-{'mcpu' if arch == 'native' else 'march'}={arch}") if arch else FLAGS
    return (*FLAGS, f"-march={arch}", "-mprefer-vector-width=512")


def _wanted() -> Path:
    """Returns the path of the library for the sources, the flags and, if they are specific to it, the processor."""
    about = [sources_sha256(), platform.machine(), *flags(), _processor()]
    name = hashlib.sha256("\n".join(about).encode()).hexdigest()[:32]
    return options().kernel_folder / f"{name}.so"


def _processor() -> str:
    return identity() if options().kernel_arch == "native" else ""


def _manifest(path: Path) -> Manifest | None:
    try:
        return Manifest.model_validate_json(path.read_bytes())
    except (OSError, ValidationError):
        return None


def _sha256(path: Path) -> str | None:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return None


def _why_none() -> str:
    """Returns the reason why the newest library in the folder may not be loaded."""
    folder = options().kernel_folder
    newest = max(folder.glob("*.json"), key=lambda path: path.stat().st_mtime, default=None)
    manifest = None if newest is None else _manifest(newest)
    if manifest is None:
        return f"there are no compiled kernels in {folder}, and no C++ compiler"
    reason = manifest.refusal() or "they are damaged: the library is not the one that was compiled"
    return f"the compiled kernels in {folder} cannot be used ({reason}), and there is no C++ compiler"


def _compiler() -> str | None:
    return shutil.which(os.environ.get("CXX", "g++"))


def _compile(path: Path) -> Manifest:
    compiler = _compiler()
    assert compiler is not None
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        library, words = Path(folder) / "kernels.so", Path(folder) / "kernels.json"
        _output(compiler, *flags(), "-o", str(library), *map(str, sorted(SOURCES.glob("*.cpp"))))
        manifest = Manifest(
            sources=sources_sha256(),
            machine=platform.machine(),
            flags=flags(),
            processor=_processor(),
            features=tuple(sorted(needed(_output(compiler, *flags(), "-dM", "-E", "-x", "c++", os.devnull)))),
            compiler=_output(compiler, "--version").splitlines()[0],
            library_sha256=str(_sha256(library)),
        )
        words.write_text(manifest.model_dump_json(indent=1) + "\n")
        library.replace(path)  # atomic: of two concurrent builds the last one stays
        words.replace(path.with_suffix(".json"))  # last: a library without a manifest is not loaded
    return manifest


def _output(*command: str) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


if __name__ == "__main__":
    use(Options.of_environment())
    try:
        path, _ = library_path()
    except subprocess.CalledProcessError as error:
        sys.exit(f"the kernels do not compile:\n{error.stderr}")
    except OSError as error:
        sys.exit(str(error))
    print(path)
