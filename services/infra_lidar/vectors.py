"""Vectors for kernels: ``LANES`` numbers in one variable, computed at once.

The compiler finds vectors in plain loops only where every iteration writes one array and nothing decides anything. What
a frame spends its time with is written with vectors instead: they stay in registers from step to step, and no search
for them costs time at compilation. They are generic LLVM vectors that fit any processor.

    x = load(a, i)                        # a[i : i + LANES]
    store(out, i, root(x * x + y * y))
    lane_min(select(x > 0.0, x, 1e9))     # smallest positive one

A number beside a vector stands for as many of it. ``load`` and ``store`` convert from and to the array's type, so flags
can be kept as bool and small integers as int16. Nothing checks bounds: arrays need room for whole vectors.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import signature

from services.infra_lidar.vector_memory import (
    every,
    gather,
    gather_listed,
    load,
    load_of_row,
    prefetch,
    store,
    store_chosen,
)
from services.infra_lidar.vector_types import (
    BIT,
    FLAGS,
    FLOATS,
    INTS,
    LANES,
    WORD,
    Emit,
    Vector,
    as_intrinsic,
    compare,
    kind_of,
    lane_list,
    spread_number,
)  # fmt: skip

__all__ = [
    "LANES",
    "bit_count",
    "bits",
    "every",
    "first_bit",
    "floor",
    "fma",
    "gather",
    "gather_listed",
    "lane_count",
    "lane_max",
    "lane_min",
    "lane_sum",
    "lanes",
    "larger",
    "load",
    "load_of_row",
    "magnitude",
    "ones",
    "prefetch",
    "root",
    "select",
    "smaller",
    "splat",
    "store",
    "store_chosen",
    "unbits",
    "whole",
]  # fmt: skip


def _function(emit: dict[Vector, Emit], result: Any = None) -> Callable[[Callable[..., Any]], Any]:
    """A decorator: the name and the text stay, what is done is ``emit`` of the kind of vector."""

    def decorate(named: Callable[..., Any]) -> Any:
        def definition(typing_context: Any, *arguments: Any) -> Any:
            kind = kind_of(arguments)
            if kind is None or kind not in emit:
                raise TypeError(f"{named.__name__}: not for {arguments}")
            build = emit[kind]
            return signature(result or kind, *[kind] * len(arguments)), lambda c, builder, s, args: build(
                builder, *args
            )

        return as_intrinsic(definition, named)

    return decorate


def _choose(sign: str) -> dict[Vector, Emit]:
    """The first of two where the comparison holds, else the second."""
    by = compare(sign)
    return {
        FLOATS: lambda builder, a, b: builder.select(by[FLOATS](builder, a, b), a, b),
        INTS: lambda builder, a, b: builder.select(by[INTS](builder, a, b), a, b),
    }


@_function(_choose("<"))
def smaller(a: Any, b: Any) -> Any:
    """The smaller one, lane by lane; b where one of them is no number."""


@_function(_choose(">"))
def larger(a: Any, b: Any) -> Any:
    """The larger one, lane by lane; b where one of them is no number."""


def _llvm(name: str) -> dict[Vector, Emit]:
    """A function that LLVM knows."""

    def emit(builder: Any, *args: Any) -> Any:
        kind = ir.FunctionType(args[0].type, [a.type for a in args])
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f32"), args)

    return {FLOATS: emit}


@_function(_llvm("fma"))
def fma(a: Any, b: Any, c: Any) -> Any:
    """a * b + c, rounded once."""


@_function(_llvm("sqrt"))
def root(a: Any) -> Any:
    """The square root."""


@_function(_llvm("floor"))
def floor(a: Any) -> Any:
    """The largest whole number that is not larger."""


@_function(_llvm("fabs"))
def magnitude(a: Any) -> Any:
    """The number without its sign."""


@_function({FLOATS: lambda builder, a: builder.fptosi(a, INTS.llvm)}, INTS)
def whole(a: Any) -> Any:
    """Floats to ints, towards zero; anything where it does not fit or is no number."""


@_function({FLOATS: lambda builder, a: builder.bitcast(a, INTS.llvm)}, INTS)
def bits(a: Any) -> Any:
    """The bits of floats as ints: of numbers that are not negative they have the same order."""


@_function({INTS: lambda builder, a: builder.bitcast(a, FLOATS.llvm)}, FLOATS)
def unbits(a: Any) -> Any:
    """Back to floats."""


@_function({FLAGS: lambda builder, flags: builder.zext(flags, INTS.llvm)}, INTS)
def ones(flags: Any) -> Any:
    """1 where a flag is set, else 0."""


def _count(builder: Any, flags: Any) -> Any:
    return builder.zext(builder.ctpop(builder.bitcast(flags, ir.IntType(LANES))), WORD)


@_function({FLAGS: _count}, types.int32)
def lane_count(flags: Any) -> Any:
    """How many flags are set."""


def _fold(join: dict[Vector, Emit]) -> Callable[[Callable[..., Any]], Any]:
    """A decorator: one number of all lanes, by halves."""

    def fold(builder: Any, kind: Vector, vector: Any) -> Any:
        half = LANES // 2
        while half:
            other = builder.shuffle_vector(vector, vector, lane_list([(i + half) % LANES for i in range(LANES)]))
            vector, half = join[kind](builder, vector, other), half // 2
        return builder.extract_element(vector, ir.Constant(WORD, 0))

    def decorate(named: Callable[..., Any]) -> Any:
        def definition(typing_context: Any, vector: Any) -> Any:
            if vector not in join:
                raise TypeError(f"{named.__name__}: not for {vector}")
            return vector.scalar(vector), lambda context, builder, sig, args: fold(builder, vector, args[0])

        return as_intrinsic(definition, named)

    return decorate


@_fold({FLOATS: ir.IRBuilder.fadd, INTS: ir.IRBuilder.add})
def lane_sum(vector: Any) -> Any:
    """The sum of all lanes."""


@_fold(_choose("<"))
def lane_min(vector: Any) -> Any:
    """The smallest of all lanes."""


@_fold(_choose(">"))
def lane_max(vector: Any) -> Any:
    """The largest of all lanes."""


def _splat(typing_context: Any, number: Any) -> Any:
    kind = FLOATS if isinstance(number, types.Float) else INTS
    return kind(number), lambda context, builder, sig, args: spread_number(context, builder, number, kind, args[0])


def _lanes(typing_context: Any) -> Any:
    return INTS(), lambda context, builder, sig, args: lane_list(list(range(LANES)))


def _select(typing_context: Any, flags: Any, a: Any, b: Any) -> Any:
    kind = kind_of((a, b))
    if flags != FLAGS or kind is None:
        raise TypeError(f"select: not for {flags}, {a}, {b}")
    return kind(FLAGS, kind, kind), lambda context, builder, sig, args: builder.select(*args)


def _first_bit(typing_context: Any, word: Any) -> Any:
    return types.int32(types.uint64), lambda context, builder, sig, args: builder.trunc(
        builder.cttz(args[0], ir.Constant(BIT, 1)), WORD
    )


def _bit_count(typing_context: Any, word: Any) -> Any:
    return types.int32(types.uint64), lambda context, builder, sig, args: builder.trunc(builder.ctpop(args[0]), WORD)


def _named(definition: Callable[..., Any]) -> Callable[[Callable[..., Any]], Any]:
    return lambda named: as_intrinsic(definition, named)


@_named(_splat)
def splat(number: Any) -> Any:
    """A vector of one number: of floats, or of ints."""


@_named(_lanes)
def lanes() -> Any:
    """0, 1, 2 ... as ints."""


@_named(_select)
def select(flags: Any, a: Any, b: Any) -> Any:
    """a where a flag is set, else b."""


@_named(_first_bit)
def first_bit(word: Any) -> Any:
    """Place of the lowest set bit of a uint64 that is not 0."""


@_named(_bit_count)
def bit_count(word: Any) -> Any:
    """How many bits of a uint64 are set."""
