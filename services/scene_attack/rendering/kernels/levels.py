"""Chooses which of the compiled kernels a process loads.

The kernels are compiled when the package is built (src/CMakeLists.txt), on x86-64 once for each of two levels of the
architecture: AVX-512 (v4) and AVX2 (v3). The option `kernels` names a level; "auto" takes the first that is there and
that the processor can run. A package that was built without a compiler has none, and torch does their work.
"""

import ctypes
import platform
from pathlib import Path

from scene_attack.errors import InvalidRequest
from scene_attack.process import cpuinfo, options

V3 = frozenset(
    {"pni", "ssse3", "sse4_1", "sse4_2", "popcnt", "cx16", "lahf_lm"}
    | {"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"}
)
V4 = V3 | {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}
NEEDS = {"v4": V4, "v3": V3} if platform.machine() == "x86_64" else {"baseline": frozenset[str]()}
"""The processor's features that each level needs, as /proc/cpuinfo names them; the fastest level comes first."""


def level() -> str | None:
    """Returns the level of the kernels to load: "v4", "v3", or "baseline" where that is not x86-64; None for torch.

    Raises InvalidRequest, naming the setting, if a level is asked for and cannot be loaded.
    """
    asked = options().kernels
    if asked == "torch":
        return None
    if asked == "auto":
        return next((level for level in NEEDS if refusal(level) is None), None)
    if reason := refusal(asked):
        raise InvalidRequest(f"SCENE_ATTACK_KERNELS={asked}", f"{reason}; use auto or torch")
    return asked


def library_path(level: str) -> Path:
    """Returns the place of a level's library."""
    return Path(__file__).with_name(f"kernels-{level}.so")


def refusal(level: str) -> str | None:
    """Returns the reason why this process cannot load a level's kernels, as a clause; None if it can."""
    if level not in NEEDS:
        return f"the kernels {level} are for x86-64, and this is {platform.machine()}"
    if not library_path(level).is_file():
        return f"the kernels {level} are not in this installation, which was built without a C++ compiler"
    if missing := sorted(NEEDS[level] - features()):
        return f"the kernels {level} need {', '.join(missing)}, which this processor lacks"
    try:
        ctypes.CDLL(str(library_path(level)))
    except OSError as error:
        return f"the kernels {level} cannot be loaded ({error})"
    return None


def why_none() -> str:
    """Returns the reason why torch computes where no kernels are loaded, as a clause."""
    if options().kernels == "torch":
        return "SCENE_ATTACK_KERNELS is torch"
    return "; ".join(filter(None, map(refusal, NEEDS)))


def features() -> frozenset[str]:
    """Returns the features of an x86-64 processor as /proc/cpuinfo names them."""
    return frozenset(cpuinfo().get("flags", "").split())
