"""One place for how kernels are compiled: single-threaded, without the interpreter lock, cached on disk.

``error_model="numpy"`` matters: with the default model every division is checked, and loops stop being vectorised
(the polar pass is 14 times slower). ``fastmath`` is left out: it moves points across cell edges.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.core.registry import cpu_target
from numba.core.typing import builtins
from numba.core.typing.arraydecl import GetItemBuffer
from numba.core.typing.templates import infer_global

from common.compiled_from import watch_all_sources
from common.processor import aim_at_level
from services.infra_lidar.arrays_in_place import take_arrays_in_place
from services.infra_lidar.code_on_demand import CodegenOnDemand
from services.infra_lidar.direct_calls import put_down_in_place
from services.infra_lidar.lifetimes_on_demand import ask_for_lifetimes
from services.infra_lidar.loops_in_place import put_down_loops
from services.infra_lidar.references_on_demand import count_on_demand

F = TypeVar("F", bound=Callable[..., Any])


aim_at_level()
watch_all_sources()
ASKED_FIRST = {"metadata": {"target": "cpu"}}  # numba asks what it knows of this target before what it knows of all
# What kernels index is an array, what they compute with are numbers. Elsewise a tenth of all compiling goes into asking
# whether it is a list, a dictionary, a text, a date.
_MEANT: dict[Any, tuple[Any, ...]] = {
    GetItemBuffer: (operator.getitem,),
    builtins.BinOp: (operator.add, operator.sub, operator.mul),
    builtins.BinOpTrueDiv: (operator.truediv,),
    builtins.BinOpFloorDiv: (operator.floordiv,),
    builtins.BinOpMod: (operator.mod,),
    builtins.BitwiseLogicOperation: (operator.and_, operator.or_, operator.xor),
    builtins.OrderedCmpOp: (operator.lt, operator.le, operator.gt, operator.ge),
}
for _template, _symbols in _MEANT.items():
    for _symbol in _symbols:
        infer_global(_symbol)(type(f"{_symbol.__name__}_first", (_template,), ASKED_FIRST))
put_down_in_place(ASKED_FIRST)
ask_for_lifetimes()
take_arrays_in_place()
count_on_demand()
put_down_loops()
cpu_target.target_context.codegen().__class__ = CodegenOnDemand  # the one that there is has no other way to be replaced

_NOT_FROM_C: dict[str, Any] = {"no_cfunc_wrapper": True}  # which numba's types do not know
_NOT_FROM_PYTHON = _NOT_FROM_C | {"no_cpython_wrapper": True}


def kernel(function: F) -> F:
    """Compile on first call for the argument types met; the result is cached beside the source file."""
    return cast(F, numba.njit(nogil=True, cache=True, error_model="numpy", **_NOT_FROM_C)(function))


def inner(function: F) -> F:
    """A function that only kernels call: without a way in from Python, it takes a quarter less time to compile."""
    return cast(F, numba.njit(nogil=True, error_model="numpy", **_NOT_FROM_PYTHON)(function))


def alone(function: F) -> F:
    """An ``inner`` function as a kernel of its own: for tests, which call it from Python."""
    return kernel(cast(Any, function).py_func)


def inline(function: F) -> F:
    """A small function that is compiled into the kernels that call it."""
    return cast(F, numba.njit(nogil=True, error_model="numpy", inline="always")(function))


def sum_kernel(function: F) -> F:
    """A kernel of sums and extremes only: their order may change, so that they vectorise. Never for binning."""
    freedom = {"reassoc", "nsz", "nnan", "contract"}
    return cast(F, numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=freedom, **_NOT_FROM_C)(function))
