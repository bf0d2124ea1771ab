"""What this machine's processor can do, and what compiled code needs of it."""

import hashlib
from functools import lru_cache
from pathlib import Path

CPUINFO = Path("/proc/cpuinfo")
OF_MACROS = {
    "__SSE3__": "pni", "__SSSE3__": "ssse3", "__SSE4_1__": "sse4_1", "__SSE4_2__": "sse4_2", "__POPCNT__": "popcnt",
    "__AVX__": "avx", "__AVX2__": "avx2", "__FMA__": "fma", "__F16C__": "f16c", "__BMI__": "bmi1", "__BMI2__": "bmi2",
    "__LZCNT__": "abm", "__MOVBE__": "movbe", "__AVX512F__": "avx512f", "__AVX512CD__": "avx512cd",
    "__AVX512DQ__": "avx512dq", "__AVX512BW__": "avx512bw", "__AVX512VL__": "avx512vl",
    "__ARM_FEATURE_SVE": "sve", "__ARM_FEATURE_DOTPROD": "asimddp",
}  # fmt: skip
"""The compiler's predefined macro for each instruction set it may use, and the word of /proc/cpuinfo for the same."""


@lru_cache(maxsize=1)
def features() -> frozenset[str]:
    """The processor's features, in the words of /proc/cpuinfo (`flags`, or `Features` on ARM)."""
    return frozenset(_line("flags", "features").split())


@lru_cache(maxsize=1)
def identity() -> str:
    """sha256 of the processor's name and features: code compiled for one may not run, or differ, on another."""
    about = f"{_line('model name', 'cpu part')}\n{' '.join(sorted(features()))}"
    return hashlib.sha256(about.encode()).hexdigest()


def needed(macros: str) -> set[str]:
    """The features that code may use, given the compiler's predefined macros (`-dM -E`)."""
    defined = {line.split()[1] for line in macros.splitlines() if line.startswith("#define")}
    return {feature for macro, feature in OF_MACROS.items() if macro in defined}


def _line(*names: str) -> str:
    """The first line of /proc/cpuinfo that has one of these names, without its name; empty where there is none."""
    for line in CPUINFO.read_text().splitlines():
        name, _, value = line.partition(":")
        if name.strip().lower() in names:
            return value.strip()
    return ""
