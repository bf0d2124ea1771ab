"""Reads the features of this machine's processor, and finds those that compiled code requires."""

import hashlib
from functools import lru_cache
from pathlib import Path

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
