"""Vectors for kernels: ``LANES`` numbers in one variable, computed at once.

The compiler finds vectors in plain loops only where every iteration writes one array and nothing decides anything. What
a frame spends its time with is written with vectors instead: they stay in registers from step to step, and no search
for them costs time at compilation. They are generic LLVM vectors that fit any processor.

    x = load(a, i)                        # a[i : i + LANES]
    store(out, i, root(x * x + y * y))
    lane_min(select(x > 0.0, x, 1e9))        # smallest positive one

A number beside a vector stands for as many of it. ``load`` and ``store`` convert from and to the array's type, so flags
can be kept as bool and small integers as int16. Nothing checks bounds: arrays need room for whole vectors.

Whoever changes this file has to clear the compiled kernels of its users: their cache does not notice.
"""

from __future__ import annotations

import inspect
import operator
from collections.abc import Callable
from typing import Any

from llvmlite import binding, ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model

_PROCESSOR = binding.get_host_cpu_features()
LANES = 16 if _PROCESSOR.get("avx512f") else 8  # of 32 bits; processors with shorter vectors split them

_WORD, _BIT = ir.IntType(32), ir.IntType(1)
_SCALARS = {types.float32: ir.FloatType(), types.int32: _WORD, types.boolean: _BIT}


class Vector(types.Type):  # type: ignore[misc]
    """``LANES`` of float32, int32 or flags."""

    def __init__(self, scalar: types.Type) -> None:
        self.scalar = scalar
        super().__init__(name=f"vector({scalar} x {LANES})")

    @property
    def llvm(self) -> ir.VectorType:
        """As LLVM has it."""
        return ir.VectorType(_SCALARS[self.scalar], LANES)


FLOATS, INTS, FLAGS = Vector(types.float32), Vector(types.int32), Vector(types.boolean)


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Vector) -> None:
        super().__init__(manager, kind, kind.llvm)


def _indices(lanes: list[int]) -> ir.Constant:
    return ir.Constant(ir.VectorType(_WORD, len(lanes)), lanes)


def _splat(builder: ir.IRBuilder, kind: Vector, value: ir.Value) -> ir.Value:
    one = builder.insert_element(ir.Constant(kind.llvm, ir.Undefined), value, ir.Constant(_WORD, 0))
    return builder.shuffle_vector(one, ir.Constant(kind.llvm, ir.Undefined), _indices([0] * LANES))


@lower_cast(types.Float, FLOATS)
@lower_cast(types.Integer, FLOATS)
@lower_cast(types.Integer, INTS)
def _cast(context: Any, builder: ir.IRBuilder, given: types.Type, kind: Vector, value: ir.Value) -> ir.Value:
    return _splat(builder, kind, context.cast(builder, value, given, kind.scalar))


# Operators


def _vectors(arguments: tuple[Any, ...]) -> Vector | None:
    """The kind of vector that the arguments are, numbers counted as such; None where they do not go together."""
    kinds = {a for a in arguments if isinstance(a, Vector)}
    numbers = all(isinstance(a, Vector | types.Integer | types.Float) for a in arguments)
    kind = kinds.pop() if len(kinds) == 1 and numbers else None
    floats_in_ints = kind == INTS and any(isinstance(a, types.Float) for a in arguments)
    return None if floats_in_ints else kind


def _operator(symbol: Any, emit: dict[Vector, Callable[..., Any]], result: Vector | None = None) -> None:
    @infer_global(symbol)
    class _Template(AbstractTemplate):  # type: ignore[misc]
        def generic(self, args: Any, kws: Any) -> Any:
            kind = _vectors(args)
            return signature(result or kind, *[kind] * len(args)) if kind in emit else None

    for kind, build in emit.items():

        @lower_builtin(symbol, *[kind] * (1 if symbol is operator.invert else 2))
        def _lower(context: Any, builder: Any, sig: Any, args: Any, build: Any = build) -> Any:
            return build(builder, *args)


_B = ir.IRBuilder
for _plain, _in_place, _emit in (
    (operator.add, operator.iadd, {FLOATS: _B.fadd, INTS: _B.add}),
    (operator.sub, operator.isub, {FLOATS: _B.fsub, INTS: _B.sub}),
    (operator.mul, operator.imul, {FLOATS: _B.fmul, INTS: _B.mul}),
    (operator.and_, operator.iand, {INTS: _B.and_, FLAGS: _B.and_}),
    (operator.or_, operator.ior, {INTS: _B.or_, FLAGS: _B.or_}),
):
    _operator(_plain, _emit)
    _operator(_in_place, _emit)
_operator(operator.truediv, {FLOATS: _B.fdiv})
_operator(operator.invert, {INTS: _B.not_, FLAGS: _B.not_})
_operator(operator.xor, {INTS: _B.xor, FLAGS: _B.xor})
_operator(operator.lshift, {INTS: _B.shl})
_operator(operator.rshift, {INTS: _B.ashr})
for _symbol, _sign in (
    (operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="), (operator.eq, "=="),
    (operator.ne, "!="),
):  # fmt: skip
    _operator(
        _symbol,
        {
            FLOATS: lambda b, x, y, s=_sign: b.fcmp_ordered(s, x, y),
            INTS: lambda b, x, y, s=_sign: b.icmp_signed(s, x, y),
        },
        FLAGS,
    )


# Functions


def _function(emit: dict[Vector, Callable[..., Any]], result: Any = None) -> Any:
    """A decorator: the function's name and text stay, what it does is ``emit`` of its kind."""

    def decorate(named: Callable[..., Any]) -> Any:
        def typed(typing_context: Any, *arguments: Any) -> Any:
            kind = _vectors(arguments)
            if kind not in emit:
                raise TypeError(f"{named.__name__}: not for {arguments}")

            def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
                return emit[kind](builder, *args)

            return signature(result or kind, *[kind] * len(arguments)), generate

        return _named(typed, named)

    return decorate


def _named(typed: Callable[..., Any], named: Callable[..., Any]) -> Any:
    """An intrinsic of ``typed`` with the name, the text and the arguments of ``named``."""
    own, context = inspect.signature(named), inspect.Parameter("typing_context", inspect.Parameter.POSITIONAL_ONLY)
    typed.__name__, typed.__doc__ = named.__name__, named.__doc__
    typed.__signature__ = own.replace(parameters=[context, *own.parameters.values()])  # type: ignore[attr-defined]
    return intrinsic(typed)


def _choose(compare: str, sign: str) -> Callable[..., Any]:
    return lambda b, x, y: b.select(getattr(b, compare)(sign, x, y), x, y)


@_function({FLOATS: _choose("fcmp_ordered", "<"), INTS: _choose("icmp_signed", "<")})
def smaller(a: Any, b: Any) -> Any:
    """The smaller one, lane by lane; b where one of them is no number."""


@_function({FLOATS: _choose("fcmp_ordered", ">"), INTS: _choose("icmp_signed", ">")})
def larger(a: Any, b: Any) -> Any:
    """The larger one, lane by lane; b where one of them is no number."""


def _llvm(name: str) -> Callable[..., Any]:
    def emit(builder: ir.IRBuilder, *args: ir.Value) -> ir.Value:
        kind = ir.FunctionType(args[0].type, [a.type for a in args])
        function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f32")
        return builder.call(function, args)

    return emit


@_function({FLOATS: _llvm("fma")})
def fma(a: Any, b: Any, c: Any) -> Any:
    """a * b + c, rounded once."""


@_function({FLOATS: _llvm("sqrt")})
def root(a: Any) -> Any:
    """The square root."""


@_function({FLOATS: _llvm("floor")})
def floor(a: Any) -> Any:
    """The largest whole number that is not larger."""


@_function({FLOATS: _llvm("fabs")})
def magnitude(a: Any) -> Any:
    """The number without its sign."""


@_function({FLOATS: lambda b, x: b.fptosi(x, INTS.llvm)}, INTS)
def whole(a: Any) -> Any:
    """Floats to ints, towards zero; anything where it does not fit or is no number."""


@_function({INTS: lambda b, x: b.sitofp(x, FLOATS.llvm)}, FLOATS)
def real(a: Any) -> Any:
    """Ints to floats."""


@_function({FLOATS: lambda b, x: b.bitcast(x, INTS.llvm)}, INTS)
def bits(a: Any) -> Any:
    """The bits of floats as ints: of numbers that are not negative they have the same order."""


@_function({INTS: lambda b, x: b.bitcast(x, FLOATS.llvm)}, FLOATS)
def unbits(a: Any) -> Any:
    """Back to floats."""


@_function({FLAGS: lambda b, x: b.zext(x, INTS.llvm)}, INTS)
def ones(flags: Any) -> Any:
    """1 where a flag is set, else 0."""


@_function({FLAGS: lambda b, x: b.zext(b.ctpop(b.bitcast(x, ir.IntType(LANES))), _WORD)}, types.int32)
def lane_count(flags: Any) -> Any:
    """How many flags are set."""


@_function({FLAGS: lambda b, x: b.zext(b.bitcast(x, ir.IntType(LANES)), _WORD)}, types.uint32)
def lane_mask(flags: Any) -> Any:
    """One bit a lane, the first lane lowest."""


def _fold(join: Callable[..., Any]) -> Callable[..., Any]:
    """A number of all lanes, by halves."""

    def emit(builder: ir.IRBuilder, vector: ir.Value) -> ir.Value:
        half = LANES // 2
        while half:
            other = builder.shuffle_vector(vector, vector, _indices([(i + half) % LANES for i in range(LANES)]))
            vector, half = join(builder, vector, other), half // 2
        return builder.extract_element(vector, ir.Constant(_WORD, 0))

    return emit


def _reduction(joins: dict[Vector, Callable[..., Any]]) -> Any:
    """A decorator: one number of a vector."""

    def decorate(named: Callable[..., Any]) -> Any:
        def typed(typing_context: Any, vector: Any) -> Any:
            if vector not in joins:
                raise TypeError(f"{named.__name__}: not for {vector}")
            emit = _fold(joins[vector])
            return vector.scalar(vector), lambda context, builder, sig, args: emit(builder, *args)

        return _named(typed, named)

    return decorate


@_reduction({FLOATS: _B.fadd, INTS: _B.add})
def lane_sum(vector: Any) -> Any:
    """The sum of all lanes."""


@_reduction({FLOATS: _choose("fcmp_ordered", "<"), INTS: _choose("icmp_signed", "<")})
def lane_min(vector: Any) -> Any:
    """The smallest of all lanes."""


@_reduction({FLOATS: _choose("fcmp_ordered", ">"), INTS: _choose("icmp_signed", ">")})
def lane_max(vector: Any) -> Any:
    """The largest of all lanes."""


@intrinsic  # type: ignore[untyped-decorator]
def splat(typing_context: Any, number: Any) -> Any:
    """A vector of one number: of floats, or of ints."""
    kind = FLOATS if isinstance(number, types.Float) else INTS
    return kind(number), lambda context, builder, sig, args: _cast(context, builder, number, kind, args[0])


@intrinsic  # type: ignore[untyped-decorator]
def lanes(typing_context: Any) -> Any:
    """0, 1, 2 ... as ints."""
    return INTS(), lambda context, builder, sig, args: _indices(list(range(LANES)))


@intrinsic  # type: ignore[untyped-decorator]
def select(typing_context: Any, flags: Any, a: Any, b: Any) -> Any:
    """a where a flag is set, else b."""
    kind = _vectors((a, b))
    if flags != FLAGS or kind is None:
        raise TypeError(f"select: not for {flags}, {a}, {b}")
    return kind(FLAGS, kind, kind), lambda context, builder, sig, args: builder.select(*args)


# Memory


def _kind_of(array: types.Array) -> Vector:
    if array.layout != "C":
        raise TypeError(f"a vector's numbers lie side by side, those of {array} do not")
    if array.dtype == types.boolean:
        return FLAGS
    return FLOATS if isinstance(array.dtype, types.Float) else INTS


def _place(context: Any, builder: Any, sig: Any, args: Any, element: ir.Type) -> Any:
    """Where the vector begins in the array args[0], as a pointer to a vector of what the array holds."""
    array = context.make_array(sig.args[0])(context, builder, args[0])
    index = context.cast(builder, args[1], sig.args[1], types.int64)
    place = builder.gep(array.data, [index])
    return builder.bitcast(place, ir.VectorType(element, LANES).as_pointer())


def _bytes(element: ir.Type) -> int:
    return element.width // 8 if isinstance(element, ir.IntType) else 4


@intrinsic  # type: ignore[untyped-decorator]
def load(typing_context: Any, array: Any, at: Any) -> Any:
    """array[at : at + LANES], of a contiguous array of float32, of integers up to 32 bits, or bool."""
    kind = _kind_of(array)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        element = context.get_data_type(array.dtype)
        place = _place(context, builder, sig, args, element)
        vector = builder.load(place, align=_bytes(element))
        if kind == FLAGS:
            return builder.trunc(vector, FLAGS.llvm)
        if kind == INTS and element != _WORD:
            return (builder.sext if array.dtype.signed else builder.zext)(vector, INTS.llvm)
        return vector

    return kind(array, at), generate


@intrinsic  # type: ignore[untyped-decorator]
def store(typing_context: Any, array: Any, at: Any, vector: Any) -> Any:
    """array[at : at + LANES] = vector; flags also into integers."""
    _kind_of(array)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        element, value = context.get_data_type(array.dtype), args[2]
        place = _place(context, builder, sig, args, element)
        if value.type.element != element:
            wide = ir.VectorType(element, LANES)
            value = builder.zext(value, wide) if vector == FLAGS else builder.trunc(value, wide)
        builder.store(value, place, align=_bytes(element))
        return context.get_dummy_value()

    return types.void(array, at, vector), generate


@intrinsic  # type: ignore[untyped-decorator]
def store_chosen(typing_context: Any, array: Any, at: Any, vector: Any, flags: Any) -> Any:
    """Store the lanes whose flag is set, side by side from array[at] on. What lies behind them may be overwritten, up
    to array[at + LANES - 1]."""
    _kind_of(array)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        place = _place(context, builder, sig, args[:2], context.get_data_type(array.dtype))
        for has, emit in ((_PROCESSOR.get("avx512f"), _compress), (_PROCESSOR.get("avx2"), _permute)):
            if has:
                emit(builder, place, args[2], args[3])
                return context.get_dummy_value()
        _store_in_turn(builder, place, args[2], args[3])
        return context.get_dummy_value()

    return types.void(array, at, vector, FLAGS), generate


def _compress(builder: ir.IRBuilder, place: ir.Value, vector: ir.Value, flags: ir.Value) -> None:
    """As one instruction."""
    suffix = "f32" if vector.type == FLOATS.llvm else "i32"
    element = builder.bitcast(place, vector.type.element.as_pointer())
    kind = ir.FunctionType(ir.VoidType(), [vector.type, element.type, flags.type])
    name = f"llvm.masked.compressstore.v{LANES}{suffix}"
    builder.call(cgutils.get_or_insert_function(builder.module, kind, name), [vector, element, flags])


def _permute(builder: ir.IRBuilder, place: ir.Value, vector: ir.Value, flags: ir.Value) -> None:
    """By a table: which lanes come first, for each of 256 masks."""
    orders = [[lane for lane in range(8) if word >> lane & 1] for word in range(256)]
    flat = [lane for order in orders for lane in order + [0] * (8 - len(order))]
    byte, table = ir.IntType(8), ir.ArrayType(ir.IntType(8), 256 * 8)
    name = "spotter.chosen_lanes"
    known = builder.module.globals.get(name)
    if known is None:
        known = cgutils.global_constant(builder, name, ir.Constant(table, bytearray(flat)))
        builder.module.globals[name] = known
    word = builder.zext(builder.bitcast(flags, byte), ir.IntType(64))
    first = builder.gep(known, [ir.Constant(_WORD, 0), builder.mul(word, ir.Constant(word.type, 8))])
    order = builder.zext(builder.load(builder.bitcast(first, ir.VectorType(byte, 8).as_pointer()), align=8), INTS.llvm)
    kind = ir.FunctionType(INTS.llvm, [INTS.llvm, INTS.llvm])
    permute = cgutils.get_or_insert_function(builder.module, kind, "llvm.x86.avx2.permd")
    moved = builder.call(permute, [builder.bitcast(vector, INTS.llvm), order])
    builder.store(builder.bitcast(moved, vector.type), place, align=4)


def _store_in_turn(builder: ir.IRBuilder, place: ir.Value, vector: ir.Value, flags: ir.Value) -> None:
    """One after the other, without branches: the next one overwrites what is not wanted."""
    to = builder.bitcast(place, vector.type.element.as_pointer())
    for lane in range(LANES):
        index = ir.Constant(_WORD, lane)
        builder.store(builder.extract_element(vector, index), to)
        to = builder.gep(to, [builder.zext(builder.extract_element(flags, index), ir.IntType(64))])


@intrinsic  # type: ignore[untyped-decorator]
def gather(typing_context: Any, array: Any, at: Any) -> Any:
    """array[at[0]], array[at[1]] ... of ints that are not negative."""
    kind = _kind_of(array)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        vector = ir.Constant(kind.llvm, ir.Undefined)
        for lane in range(LANES):
            place = ir.Constant(_WORD, lane)
            index = builder.zext(builder.extract_element(args[1], place), ir.IntType(64))
            vector = builder.insert_element(vector, builder.load(builder.gep(data, [index])), place)
        return vector

    return kind(array, INTS), generate


@intrinsic  # type: ignore[untyped-decorator]
def gather_pairs(typing_context: Any, array: Any, at: Any) -> Any:
    """array[at, 0] and array[at, 1] of (N, 2) int32, two vectors: one look-up of eight bytes for both."""
    long = ir.IntType(64)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        pairs = ir.Constant(ir.VectorType(long, LANES), ir.Undefined)
        data = builder.bitcast(data, long.as_pointer())
        for lane in range(LANES):
            place = ir.Constant(_WORD, lane)
            index = builder.zext(builder.extract_element(args[1], place), long)
            pair = builder.load(builder.gep(data, [index]), align=4)
            pairs = builder.insert_element(pairs, pair, place)
        words = builder.bitcast(pairs, ir.VectorType(_WORD, 2 * LANES))
        halves = [builder.shuffle_vector(words, words, _indices(list(range(k, 2 * LANES, 2)))) for k in (0, 1)]
        return context.make_tuple(builder, sig.return_type, halves)

    return types.UniTuple(INTS, 2)(array, INTS), generate


@intrinsic(prefer_literal=True)  # type: ignore[untyped-decorator]
def every(typing_context: Any, array: Any, at: Any, step: Any, first: Any) -> Any:
    """array[at + first], array[at + first + step] ...: one column of LANES rows of ``step`` float32 from ``at`` on.

    ``step`` and ``first`` are literals. As many whole vectors as a row has columns are read; where no factor is common
    to their number and LANES, each lane of the column is another lane of one of them, so picking and one shuffle do.
    """
    width, column = step.literal_value, first.literal_value

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        begin = context.cast(builder, args[1], sig.args[1], types.int64)
        parts = []
        for k in range(width):
            place = builder.gep(data, [builder.add(begin, ir.Constant(begin.type, k * LANES))])
            parts.append(builder.load(builder.bitcast(place, FLOATS.llvm.as_pointer()), align=4))
        wanted = [column + width * lane for lane in range(LANES)]
        return _pick(builder, parts, wanted)

    return FLOATS(array, at, step, first), generate


def _pick(builder: ir.IRBuilder, parts: list[ir.Value], wanted: list[int]) -> ir.Value:
    """The elements ``wanted`` of the parts put in a row."""
    if len({index % LANES for index in wanted}) == LANES:
        picked = parts[0]
        for k, part in enumerate(parts[1:], start=1):
            here = {index % LANES for index in wanted if index // LANES == k}
            picked = builder.shuffle_vector(
                picked, part, _indices([LANES + i if i in here else i for i in range(LANES)])
            )
        return builder.shuffle_vector(picked, picked, _indices([index % LANES for index in wanted]))
    picked = ir.Constant(FLOATS.llvm, ir.Undefined)
    for k, part in enumerate(parts):
        lanes_from = [LANES + index % LANES if index // LANES == k else lane for lane, index in enumerate(wanted)]
        picked = builder.shuffle_vector(picked, part, _indices(lanes_from))
    return picked


@intrinsic  # type: ignore[untyped-decorator]
def bit_count(typing_context: Any, word: Any) -> Any:
    """How many bits of a uint64 are set."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.trunc(builder.ctpop(args[0]), _WORD)

    return types.int32(types.uint64), generate


@intrinsic  # type: ignore[untyped-decorator]
def first_bit(typing_context: Any, word: Any) -> Any:
    """Place of the lowest set bit of a uint64 that is not 0."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.trunc(builder.cttz(args[0], ir.Constant(_BIT, 1)), _WORD)

    return types.int32(types.uint64), generate
