"""References are counted only of what a function has made.

An array that came as an argument, and every part of it, is kept alive by the caller. Numba counts all the same whenever
one gets a name or loses it, by a function call with a locked addition; its optimiser removes some of these. Without
them kernels run faster, and take less time to compile.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from numba.core import ir, types
from numba.core.datamodel import default_manager
from numba.core.lowering import Lower

_PARTS = {
    "build_tuple", "cast", "exhaust_iter", "getattr", "getitem", "getiter", "iternext", "pair_first", "phi",
    "static_getitem",
}  # fmt: skip
# What keeps its parts as long as it lives; of a list, one could be taken away meanwhile
_KEEPERS = (types.Array, types.BaseTuple, types.IteratorType, types.Pair, types.BoundFunction)
_count_and_lower, _count_and_lower_one = Lower.lower, Lower.lower_inst
_count_and_wrap = Lower.create_cpython_wrapper

Values = dict[str, list[Any]]


def _lower(self: Any) -> None:
    """As Numba's own, with the names known that stand for what is the caller's."""
    kinds, self.lent = self.fndesc.typemap, set()
    if self.context.enable_nrt and not self.func_ir.is_generator:
        self.lent = lent(counted_values(self.func_ir, kinds), kinds)
    _count_and_lower(self)


def _lower_one(self: Any, instruction: ir.Stmt) -> None:
    """As Numba's own, without counting where such a name comes or goes. What else an instruction does may make arrays,
    as an assignment does to elements that it may be reading."""
    name = None
    if isinstance(instruction, ir.Assign):
        name = instruction.target.name
    elif isinstance(instruction, ir.Del):
        name = instruction.value
    if name not in self.lent:
        _count_and_lower_one(self, instruction)
        return
    with _counting(self.context, False):
        _count_and_lower_one(self, instruction)


def _wrap(self: Any, release_gil: bool = False) -> None:
    """As Numba's own, the way in from Python. Where nothing counted comes out of it, arguments are not counted either:
    whoever calls holds them."""
    with _counting(self.context, self.context.enable_nrt and _is_counted(self.fndesc.restype)):
        _count_and_wrap(self, release_gil)


@contextmanager
def _counting(context: Any, wanted: bool) -> Iterator[None]:
    before, context.enable_nrt = context.enable_nrt, wanted
    try:
        yield
    finally:
        context.enable_nrt = before


def counted_values(function: ir.FunctionIR, kinds: dict[str, types.Type]) -> Values:
    """What is assigned, in a typed function, to each name that holds references, and None where it is returned."""
    made: Values = {}
    for block in function.blocks.values():
        for one in block.body:
            if type(one) is ir.Assign:
                if _is_counted(kinds[one.target.name]):
                    made.setdefault(one.target.name, []).append(one.value)
            elif type(one) is ir.Return and _is_counted(kinds[one.value.name]):
                made.setdefault(one.value.name, []).append(None)
    return made


def lent(counted: Values, kinds: dict[str, types.Type]) -> set[str]:
    """The names that never stand for anything but arguments, constants, or parts of these, and are not returned. Others
    hold references of their own."""
    found, more = set(counted), True
    while more:
        own = {name for name in found if not all(_is_lent(value, found, kinds) for value in counted[name])}
        found, more = found - own, bool(own)
    return found


@cache
def _is_counted(kind: types.Type) -> bool:
    if isinstance(kind, types.BoundFunction):  # a method, which holds what it is of
        kind = kind.this
    return bool(default_manager[kind].contains_nrt_meminfo())


def _is_lent(value: Any, found: set[str], kinds: dict[str, types.Type]) -> bool:
    """Whether a value that is counted is the caller's, as long as the names ``found`` stand for what is."""
    if isinstance(value, ir.Arg | ir.Global | ir.FreeVar):
        return True
    if isinstance(value, ir.Var):
        return value.name in found
    return isinstance(value, ir.Expr) and _is_part(value, kinds) and all(
        one.name in found and isinstance(kinds[one.name], _KEEPERS)
        for one in value.list_vars()
        if _is_counted(kinds[one.name])
    )  # fmt: skip


def _is_part(value: ir.Expr, kinds: dict[str, types.Type]) -> bool:
    """Whether an expression makes nothing, but takes a part of what there is, or some of that together."""
    if value.op == "call":
        function = kinds[value.func.name]
        return isinstance(function, types.BoundFunction) and function.typing_key == "array.reshape"
    by_places = value.op == "getitem" and isinstance(kinds[value.index.name], types.Array)
    return value.op in _PARTS and not by_places


def count_on_demand() -> None:
    """Tell Numba."""
    Lower.lower = _lower  # type: ignore[method-assign]
    Lower.lower_inst = _lower_one  # type: ignore[method-assign]
    Lower.create_cpython_wrapper = _wrap  # type: ignore[method-assign]
