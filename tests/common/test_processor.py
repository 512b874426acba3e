"""Which processors kernels are compiled for."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from common.processor import LEVELS, levels_of

V4, V3 = LEVELS["x86-64-v4"], LEVELS["x86-64-v3"]


@pytest.mark.parametrize(
    ("features", "levels"),
    [
        (V4, ["x86-64-v4", "x86-64-v3"]),
        (V3, ["x86-64-v3"]),
        ((*V3, "avx512f"), ["x86-64-v3"]),  # not all of AVX-512: the Xeon Phi
        (tuple(name for name in V4 if name != "fma"), []),
        (("neon", "asimd"), []),
    ],
)
def test_levels_of_processors(features: tuple[str, ...], levels: list[str]) -> None:
    assert levels_of(dict.fromkeys(V4, False) | dict.fromkeys(features, True)) == levels


SAYS = """
from services.infra_lidar.vectors import LANES
from numba.core.registry import cpu_target
print(LANES, *cpu_target.target_context.codegen().magic_tuple()[1:])
"""


@pytest.mark.parametrize(("level", "lanes"), [("x86-64-v3", "8"), ("x86-64-v4", "16")])
def test_somebody_else_may_say_for_which(level: str, lanes: str) -> None:
    """Nothing is run that was compiled for it, so any machine can test it."""
    environment = os.environ | {"NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": ""}
    told = subprocess.run([sys.executable, "-c", SAYS], env=environment, capture_output=True, text=True, check=True)
    assert told.stdout.split() == [lanes, level]


def test_else_it_is_the_highest_level_of_this_processor() -> None:
    code = SAYS + "from llvmlite import binding\nfrom common.processor import levels_of\n"
    code += "print(*levels_of(binding.get_host_cpu_features())[:1])"
    environment = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_CPU")}
    told = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    aimed, highest = told.stdout.splitlines()
    if not highest:
        pytest.skip("this processor has no level of x86-64")
    assert aimed.split()[1:] == [highest]
