"""Lifetimes of variables that are found out on demand are the compiler's own."""

from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core import compiler, ir
from numba.core.dispatcher import Dispatcher
from numba.core.postproc import PostProcessor

import services.infra_lidar
from services.infra_lidar import jit, lifetimes_on_demand

MODULES = sorted(one.stem for one in Path(services.infra_lidar.__path__[0]).glob("*.py"))


def kernels_of(module: str) -> list[Dispatcher]:
    found = vars(__import__(f"services.infra_lidar.{module}", fromlist=["_"])).values()
    return [one for one in found if isinstance(one, Dispatcher) and one.py_func.__module__.endswith(f".{module}")]


def variables_numbas_way(part: object) -> list[str]:
    """A plain walk over everything that an instruction consists of."""
    if isinstance(part, ir.Var):
        return [part.name]
    if isinstance(part, ir.Expr):
        return variables_numbas_way(part._kws)
    if isinstance(part, ir.Yield):
        return [part.value.name]
    if isinstance(part, ir.Stmt):
        return variables_numbas_way(vars(part))
    inner = part.values() if isinstance(part, dict) else part if isinstance(part, list | tuple) else ()
    return [name for one in inner for name in variables_numbas_way(one)]


def test_there_are_kernels_to_look_at():
    assert sum(len(kernels_of(name)) for name in MODULES) > 100


@pytest.mark.parametrize("module", [name for name in MODULES if kernels_of(name)])
def test_each_variable_is_deleted_where_the_compiler_deletes_it(module):
    for kernel in kernels_of(module):
        ours, numbas = (compiler.run_frontend(kernel.py_func) for _ in range(2))
        PostProcessor(ours).run(emit_dels=True)
        lifetimes_on_demand._find_out_now(PostProcessor(numbas), True)
        for offset, block in numbas.blocks.items():
            assert list(map(str, ours.blocks[offset].body)) == list(map(str, block.body))
            for instruction in block.body:
                assert [one.name for one in instruction.list_vars()] == variables_numbas_way(instruction)


def test_what_a_generator_keeps_is_still_known():
    @numba.njit
    def squares(n):
        for k in range(n):
            weight = k * 2.0
            yield k * k
            yield weight

    assert list(squares(3)) == [0, 0, 1, 2, 4, 4]


def test_arrays_are_given_back_in_time():
    """A variable that is used for the last time in one branch only, in a loop."""

    @jit.kernel
    def folded(n):
        kept, total = np.zeros(3), 0.0
        for k in range(n):
            new = np.full(3, float(k))
            if k % 2:
                kept = new
            else:
                total += new.sum()
            total += kept[0]
        return total

    assert folded(6) == folded.py_func(6)
