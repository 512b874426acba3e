"""Which processors compiled kernels are for: all of a level, instead of the one model they were compiled on.

Numba compiles for the very model and keeps the result for no other: an image that was built elsewhere, or a machine
that was moved to another host, would begin with half a minute of compiling. The levels of x86-64 (System V psABI, 2020)
cost nothing: frames were as fast with x86-64-v4 as with the model itself. Where a processor has no level, kernels are
compiled for its model; NUMBA_CPU_NAME says otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from llvmlite import binding
from numba.core import config as numba_config

config: Any = numba_config  # its names are made when it is imported
_V3 = ("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "xsave")
LEVELS: dict[str, tuple[str, ...]] = {
    "x86-64-v4": (*_V3, "avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"),
    "x86-64-v3": _V3,
}
"""What a processor of a level has at least, of what kernels can use; the highest first."""


def levels_of(features: Mapping[str, bool]) -> list[str]:
    """The levels that a processor has, the highest first."""
    return [name for name, needed in LEVELS.items() if all(features.get(feature) for feature in needed)]


def aim_at_level() -> None:
    """Before anything is compiled."""
    if config.CPU_NAME is None:
        for name in levels_of(binding.get_host_cpu_features())[:1]:
            config.CPU_NAME, config.CPU_FEATURES = name, ""


def features() -> Mapping[str, bool]:
    """What the processors have that kernels are compiled for."""
    if config.CPU_NAME in LEVELS:
        return dict.fromkeys(LEVELS[config.CPU_NAME], True)
    found: Mapping[str, bool] = binding.get_host_cpu_features()
    return found
