"""What kernels call most often, put down in place: smaller and larger of two numbers, new arrays.

Numba has each of them compiled as a function of its own, again for every combination of types and of how its caller is
compiled: a tenth of a cold start. What they do is the same. All other ways of calling them are left to Numba.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from numba.core import cgutils, types
from numba.core.imputils import impl_ret_new_ref, lower_builtin
from numba.core.typing.npydecl import parse_dtype, parse_shape
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.cpython.builtins import do_minmax
from numba.np.arrayobj import _empty_nd_impl, _parse_empty_args, store_item

Arguments = tuple[Any, ...]
Named = dict[str, Any]


class _TwoNumbers(AbstractTemplate):
    """min(a, b) and max(a, b)."""

    def generic(self, args: Arguments, kws: Named) -> Any:
        numbers = not kws and len(args) == 2 and all(isinstance(a, types.Integer | types.Float) for a in args)
        return signature(self.context.unify_types(*args), *args) if numbers else None


class _NewArray(AbstractTemplate):
    """np.empty(shape), np.empty(shape, dtype), np.zeros and np.ones so, too."""

    def generic(self, args: Arguments, kws: Named) -> Any:
        return None if kws or len(args) > 2 else _new_array(args, types.float64, *args[1:])


class _FullArray(AbstractTemplate):
    """np.full(shape, value) and np.full(shape, value, dtype)."""

    def generic(self, args: Arguments, kws: Named) -> Any:
        return None if kws or len(args) not in (2, 3) else _new_array(args, args[1], *args[2:])


class _Counting(AbstractTemplate):
    """np.arange(n)."""

    def generic(self, args: Arguments, kws: Named) -> Any:
        counted = not kws and len(args) == 1 and args[0] in types.signed_domain
        return _new_array(args, types.intp) if counted else None


def _new_array(args: Arguments, without: Any, wanted: Any = None) -> Any:
    """What comes of the arguments: an array of the ``wanted`` dtype, or ``without`` one. None: that cannot be told."""
    dimensions, dtype = parse_shape(args[0]), without if wanted is None else parse_dtype(wanted)
    return None if dimensions is None or dtype is None else signature(types.Array(dtype, dimensions, "C"), *args)


def _smaller(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return do_minmax(context, builder, sig.args, args, operator.lt)


def _larger(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return do_minmax(context, builder, sig.args, args, operator.gt)


def _empty(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return _returned(context, builder, sig, _allocate(context, builder, sig, args))


def _zeros(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    array = _allocate(context, builder, sig, args)
    cgutils.memset(builder, array.data, builder.mul(array.itemsize, array.nitems), 0)
    return _returned(context, builder, sig, array)


def _filled(number: Callable[[Any, Any, Any, Any], tuple[Any, Any]]) -> Callable[..., Any]:
    """An array of what ``number`` (builder, signature, arguments, index) gives: a type and a value."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        array, dtype = _allocate(context, builder, sig, args), sig.return_type.dtype
        with cgutils.for_range(builder, array.nitems) as loop:
            kind, given = number(builder, sig, args, loop.index)
            value = context.cast(builder, given, kind, dtype)
            store_item(context, builder, sig.return_type, value, builder.gep(array.data, [loop.index]))
        return _returned(context, builder, sig, array)

    return lower


def _allocate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return _empty_nd_impl(context, builder, *_parse_empty_args(context, builder, sig, args))


def _returned(context: Any, builder: Any, sig: Any, array: Any) -> Any:
    return impl_ret_new_ref(context, builder, sig.return_type, array._getvalue())


_ones = _filled(lambda builder, sig, args, index: (types.intp, index.type(1)))
_full = _filled(lambda builder, sig, args, index: (sig.args[1], args[1]))
_numbered = _filled(lambda builder, sig, args, index: (types.intp, index))


def _counting(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    n, none = args[0], args[0].type(0)
    return _numbered(context, builder, sig, [builder.select(builder.icmp_signed("<", n, none), none, n)])


_CALLS: tuple[tuple[Any, type[AbstractTemplate], Callable[..., Any], tuple[int, ...]], ...] = (
    (min, _TwoNumbers, _smaller, (2,)),
    (max, _TwoNumbers, _larger, (2,)),
    (np.empty, _NewArray, _empty, (1, 2)),
    (np.zeros, _NewArray, _zeros, (1, 2)),
    (np.ones, _NewArray, _ones, (1, 2)),
    (np.full, _FullArray, _full, (2, 3)),
    (np.arange, _Counting, _counting, (1,)),
)  # what is called, how it is typed and lowered, with how many arguments


def put_down_in_place(asked_first: dict[str, Any]) -> None:
    """Tell Numba; ``asked_first`` is what makes it ask these before its own."""
    for called, template, lower, numbers_of_arguments in _CALLS:
        infer_global(called)(type(f"{called.__name__}_first", (template,), asked_first))
        for number in numbers_of_arguments:
            lower_builtin(called, *[types.Any] * number)(lower)
