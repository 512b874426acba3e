"""Loops over ``range`` that count up by one are put down in a few instructions.

Numba keeps a range in memory, divides to learn how often a step fits in, asks for its sign and whether it is nought,
and branches on each turn. Its optimiser then removes nearly all of that, a loop at a time. All other ranges are left
to it.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.imputils import builtin_registry, lower_builtin
from numba.core.registry import cpu_target
from numba.core.types import range_iter32_type, range_iter64_type, range_state32_type, range_state64_type
from numba.cpython import rangeobj  # noqa: F401  what it registers is found below, and ours has to come later

_KINDS = {
    types.int32: (range_state32_type, range_iter32_type),
    types.int64: (range_state64_type, range_iter64_type),
}
Arguments = tuple[Any, ...]


def _struct(builder: Any, kind: Any, *parts: Any) -> Any:
    value = ir.Constant(kind, ir.Undefined)
    for k, part in enumerate(parts):
        value = builder.insert_value(value, part, k)
    return value


def _range(context: Any, builder: Any, sig: Any, args: Arguments) -> Any:
    """range(stop) and range(start, stop): from where, to where, by one."""
    start = args[0] if len(args) == 2 else ir.Constant(args[0].type, 0)
    return _struct(builder, context.get_value_type(sig.return_type), start, args[-1], ir.Constant(start.type, 1))


def _parts_by_one(value: Any) -> tuple[Any, Any] | None:
    """Start and stop of a range that was put down by ``_range`` here; None of another."""
    parts = []
    while isinstance(value, ir.instructions.InsertValue):
        value, part = value.operands
        parts.append(part)
    if len(parts) != 3 or not isinstance(parts[0], ir.Constant) or parts[0].constant != 1:
        return None
    return parts[2], parts[1]


def _begin(any_other: Any) -> Any:
    """How a range's turns begin; Numba's own way for ``any_other``."""

    def begin(context: Any, builder: Any, sig: Any, args: Arguments) -> Any:
        parts = _parts_by_one(args[0])
        if parts is None:
            return any_other(context, builder, sig, args)
        start, stop = parts
        turns = builder.sub(stop, start)
        at, left = cgutils.alloca_once(builder, start.type), cgutils.alloca_once(builder, start.type)
        builder.store(start, at)
        builder.store(builder.select(builder.icmp_signed(">", stop, start), turns, ir.Constant(turns.type, 0)), left)
        kind, one = context.get_value_type(sig.return_type), ir.Constant(start.type, 1)
        return _struct(builder, kind, at, stop, one, left)

    return begin


def _next(context: Any, builder: Any, sig: Any, args: Arguments) -> Any:
    """The next number of any range, and whether there is one; where there is none, nobody looks at the number."""
    at, left, step = (builder.extract_value(args[0], k) for k in (0, 3, 2))
    number, turns = builder.load(at), builder.load(left)
    one_less = ir.Constant(turns.type, -1)
    builder.store(builder.add(number, step), at)
    builder.store(builder.add(turns, one_less, flags=["nsw"]), left)
    is_one = builder.icmp_signed(">", turns, ir.Constant(turns.type, 0))
    return _struct(builder, context.get_value_type(sig.return_type), number, is_one)


def _pair_first(self: Any, builder: Any, value: Any, kind: Any) -> Any:
    return builder.extract_value(value, 0)


def _pair_second(self: Any, builder: Any, value: Any, kind: Any) -> Any:
    return builder.extract_value(value, 1)


def _known(name: str, kind: Any) -> Any:
    """How Numba does what is called ``name`` for a type."""
    return next(how for how, what, signature in builtin_registry.functions if what == name and signature == (kind,))


def put_down_loops() -> None:
    """Tell Numba."""
    for number, (state, iterator) in _KINDS.items():
        lower_builtin(range, number)(_range)
        lower_builtin(range, number, number)(_range)
        lower_builtin("getiter", state)(_begin(_known("getiter", state)))
        lower_builtin("iternext", iterator)(_next)
    context = type(cpu_target.target_context)
    context.pair_first, context.pair_second = _pair_first, _pair_second
