"""Vectors from and to memory: side by side, here and there, rows, and only some lanes. See ``vectors.py``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils

from services.infra_lidar.vector_types import (
    BIT,
    FLAGS,
    FLOATS,
    INTS,
    LANES,
    PROCESSOR,
    WORD,
    Vector,
    as_intrinsic,
    lane_list,
)

_LONG, _BYTE = ir.IntType(64), ir.IntType(8)
_AT_ONCE = bool(PROCESSOR.get("avx512f"))  # where looking up many elements at once pays


def _kind_of(array: Any) -> Vector:
    """What an array holds, as vectors; raises ``TypeError`` where its numbers do not lie side by side."""
    if array.layout != "C":
        raise TypeError(f"a vector's numbers lie side by side, those of {array} do not")
    if array.dtype == types.boolean:
        return FLAGS
    return FLOATS if isinstance(array.dtype, types.Float) else INTS


def _begin(context: Any, builder: Any, array_type: Any, array: Any) -> Any:
    return context.make_array(array_type)(context, builder, array).data


def _place(context: Any, builder: Any, sig: Any, args: Any, element: Any) -> Any:
    """Where the vector begins in the array args[0], as a pointer to a vector of what the array holds."""
    index = context.cast(builder, args[1], sig.args[1], types.int64)
    place = builder.gep(_begin(context, builder, sig.args[0], args[0]), [index])
    return builder.bitcast(place, ir.VectorType(element, LANES).as_pointer())


def _bytes(element: Any) -> int:
    return element.width // 8 if isinstance(element, ir.IntType) else 4


def _load(typing_context: Any, array: Any, at: Any) -> Any:
    kind = _kind_of(array)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        element = context.get_data_type(array.dtype)
        vector = builder.load(_place(context, builder, sig, args, element), align=_bytes(element))
        if kind == FLAGS:
            return builder.trunc(vector, FLAGS.llvm)
        if kind == INTS and element != WORD:
            return (builder.sext if array.dtype.signed else builder.zext)(vector, INTS.llvm)
        return vector

    return kind(array, at), generate


def _load_of_row(typing_context: Any, array: Any, row: Any, at: Any) -> Any:
    kind = _kind_of(array)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        described = context.make_array(array)(context, builder, args[0])
        row, at = (context.cast(builder, args[k], sig.args[k], types.int64) for k in (1, 2))
        width = builder.extract_value(described.shape, 1)
        place = builder.gep(described.data, [builder.add(builder.mul(row, width), at)])
        return builder.load(builder.bitcast(place, kind.llvm.as_pointer()), align=4)

    return kind(array, row, at), generate


def _store(typing_context: Any, array: Any, at: Any, vector: Any) -> Any:
    _kind_of(array)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        element, value = context.get_data_type(array.dtype), args[2]
        if value.type.element != element:
            wanted = ir.VectorType(element, LANES)
            value = builder.zext(value, wanted) if vector == FLAGS else builder.trunc(value, wanted)
        builder.store(value, _place(context, builder, sig, args, element), align=_bytes(element))
        return context.get_dummy_value()

    return types.void(array, at, vector), generate


def _store_chosen(typing_context: Any, array: Any, at: Any, vector: Any, flags: Any) -> Any:
    _kind_of(array)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        place = _place(context, builder, sig, args, context.get_data_type(array.dtype))
        for feature, emit in (("avx512f", _compress), ("avx2", _permute), ("", _store_in_turn)):
            if not feature or PROCESSOR.get(feature):
                emit(builder, place, args[2], args[3])
                break
        return context.get_dummy_value()

    return types.void(array, at, vector, FLAGS), generate


def _compress(builder: Any, place: Any, vector: Any, flags: Any) -> None:
    """In a register, and then as a whole: to store only the chosen lanes takes some processors a hundred cycles."""
    kind = ir.FunctionType(vector.type, [vector.type, flags.type, vector.type])
    name = f"llvm.experimental.vector.compress.v{LANES}{'f32' if vector.type == FLOATS.llvm else 'i32'}"
    compress = cgutils.get_or_insert_function(builder.module, kind, name)
    builder.store(builder.call(compress, [vector, flags, ir.Constant(vector.type, ir.Undefined)]), place, align=4)


def _permute(builder: Any, place: Any, vector: Any, flags: Any) -> None:
    """By a table: which lanes come first, for each of 256 masks."""
    name, table = "spotter.chosen_lanes", builder.module.globals.get("spotter.chosen_lanes")
    if table is None:
        orders = [[lane for lane in range(8) if word >> lane & 1] for word in range(256)]
        flat = bytearray(lane for order in orders for lane in order + [0] * (8 - len(order)))
        table = cgutils.global_constant(builder, name, ir.Constant(ir.ArrayType(_BYTE, len(flat)), flat))
        builder.module.globals[name] = table
    word = builder.zext(builder.bitcast(flags, _BYTE), _LONG)
    first = builder.gep(table, [ir.Constant(WORD, 0), builder.mul(word, ir.Constant(_LONG, 8))])
    order = builder.load(builder.bitcast(first, ir.VectorType(_BYTE, 8).as_pointer()), align=8)
    kind = ir.FunctionType(INTS.llvm, [INTS.llvm, INTS.llvm])
    permute = cgutils.get_or_insert_function(builder.module, kind, "llvm.x86.avx2.permd")
    moved = builder.call(permute, [builder.bitcast(vector, INTS.llvm), builder.zext(order, INTS.llvm)])
    builder.store(builder.bitcast(moved, vector.type), place, align=4)


def _store_in_turn(builder: Any, place: Any, vector: Any, flags: Any) -> None:
    """One after the other, without branches: the next one overwrites what is not wanted."""
    to = builder.bitcast(place, vector.type.element.as_pointer())
    for lane in range(LANES):
        index = ir.Constant(WORD, lane)
        builder.store(builder.extract_element(vector, index), to)
        to = builder.gep(to, [builder.zext(builder.extract_element(flags, index), _LONG)])


def _gathered(builder: Any, first: Any, places: list[Any], element: Any) -> Any:
    """A vector of elements first[places[0]], first[places[1]] ..., one by one."""
    vector = ir.Constant(ir.VectorType(element, LANES), ir.Undefined)
    for lane, place in enumerate(places):
        one = builder.load(builder.gep(first, [place]), align=4)
        vector = builder.insert_element(vector, one, ir.Constant(WORD, lane))
    return vector


def _gathered_at_once(builder: Any, first: Any, places: Any, element: Any) -> Any:
    """The same as one instruction: 16 words at a time, or 8 pairs of them."""
    many, name = (LANES, "dpi") if element == WORD else (LANES // 2, "dpq")
    kind, flags = ir.VectorType(element, many), ir.VectorType(BIT, many)
    address, parts = builder.bitcast(first, _BYTE.as_pointer()), []
    takes = ir.FunctionType(kind, [kind, address.type, ir.VectorType(WORD, many), flags, WORD])
    gather = cgutils.get_or_insert_function(builder.module, takes, f"llvm.x86.avx512.mask.gather.{name}.512")
    none, all_of_them, step = ir.Constant(kind, None), ir.Constant(flags, [True] * many), element.width // 8
    for start in range(0, LANES, many):
        here = builder.shuffle_vector(places, places, lane_list(list(range(start, start + many))))
        parts.append(builder.call(gather, [none, address, here, all_of_them, ir.Constant(WORD, step)]))
    return builder.shuffle_vector(parts[0], parts[-1], lane_list(list(range(LANES))))


def _gather(typing_context: Any, array: Any, at: Any) -> Any:
    kind = _kind_of(array)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        first = _begin(context, builder, array, args[0])
        if _AT_ONCE:
            return builder.bitcast(_gathered_at_once(builder, first, args[1], WORD), kind.llvm)
        lanes = [builder.extract_element(args[1], ir.Constant(WORD, lane)) for lane in range(LANES)]
        return _gathered(builder, first, [builder.zext(lane, _LONG) for lane in lanes], kind.llvm.element)

    return kind(array, INTS), generate


def _look_up(context: Any, builder: Any, sig: Any, args: Any, element: Any) -> Any:
    """The elements of args[0] at args[1][args[2]], args[1][args[2] + 1] ..."""
    first, listed = _begin(context, builder, sig.args[0], args[0]), context.get_data_type(sig.args[1].dtype)
    if _AT_ONCE:
        place = _place(context, builder, sig.replace(args=sig.args[1:]), args[1:], listed)
        places = builder.load(place, align=_bytes(listed))
        places = places if listed == WORD else builder.sext(places, INTS.llvm)
        return _gathered_at_once(builder, first, places, element if element == _LONG else WORD)
    index = context.cast(builder, args[2], sig.args[2], types.int64)
    begin = builder.gep(_begin(context, builder, sig.args[1], args[1]), [index])
    loaded = [builder.load(builder.gep(begin, [ir.Constant(_LONG, lane)])) for lane in range(LANES)]
    typed = builder.bitcast(first, element.as_pointer())
    return _gathered(builder, typed, [builder.sext(one, _LONG) for one in loaded], element)


def _gather_listed(typing_context: Any, array: Any, listed: Any, at: Any) -> Any:
    kind = _kind_of(array)
    _kind_of(listed)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.bitcast(_look_up(context, builder, sig, args, kind.llvm.element), kind.llvm)

    return kind(array, listed, at), generate


def _prefetch(typing_context: Any, array: Any, at: Any) -> Any:
    _kind_of(array)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        index = context.cast(builder, args[1], sig.args[1], types.int64)
        place = builder.gep(_begin(context, builder, array, args[0]), [index])
        address = builder.bitcast(place, _BYTE.as_pointer())
        kind = ir.FunctionType(ir.VoidType(), [address.type, WORD, WORD, WORD])
        to_read, into_the_nearest_cache, of_data = (ir.Constant(WORD, k) for k in (0, 3, 1))
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(function, [address, to_read, into_the_nearest_cache, of_data])
        return context.get_dummy_value()

    return types.void(array, at), generate


def _every(typing_context: Any, array: Any, at: Any, step: Any, first: Any) -> Any:
    width, column = step.literal_value, first.literal_value

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        begin = context.cast(builder, args[1], sig.args[1], types.int64)
        data, parts = _begin(context, builder, array, args[0]), []
        for k in range(width):
            place = builder.gep(data, [builder.add(begin, ir.Constant(_LONG, k * LANES))])
            parts.append(builder.load(builder.bitcast(place, FLOATS.llvm.as_pointer()), align=4))
        return _picked(builder, parts, [column + width * lane for lane in range(LANES)])

    return FLOATS(array, at, step, first), generate


def _picked(builder: Any, parts: list[Any], wanted: list[int]) -> Any:
    """The elements ``wanted`` of the parts, in a row. Where each comes from another lane of its part, picking and one
    shuffle do."""
    if len({index % LANES for index in wanted}) < LANES:
        picked = ir.Constant(FLOATS.llvm, ir.Undefined)
        for k, part in enumerate(parts):
            taken = [LANES + i % LANES if i // LANES == k else lane for lane, i in enumerate(wanted)]
            picked = builder.shuffle_vector(picked, part, lane_list(taken))
        return picked
    picked = parts[0]
    for k, part in enumerate(parts[1:], start=1):
        here = {index % LANES for index in wanted if index // LANES == k}
        picked = builder.shuffle_vector(
            picked, part, lane_list([LANES + lane if lane in here else lane for lane in range(LANES)])
        )
    return builder.shuffle_vector(picked, picked, lane_list([index % LANES for index in wanted]))


def _named(definition: Callable[..., Any], **options: Any) -> Callable[[Callable[..., Any]], Any]:
    return lambda named: as_intrinsic(definition, named, **options)


@_named(_load)
def load(array: Any, at: Any) -> Any:
    """array[at : at + LANES], of float32, of integers up to 32 bits, or bool."""


@_named(_load_of_row)
def load_of_row(array: Any, row: Any, at: Any) -> Any:
    """array[row, at : at + LANES], of float32 or int32, without a view of the row being made."""


@_named(_store)
def store(array: Any, at: Any, vector: Any) -> Any:
    """array[at : at + LANES] = vector; flags also into integers."""


@_named(_store_chosen)
def store_chosen(array: Any, at: Any, vector: Any, flags: Any) -> Any:
    """Store the lanes whose flag is set, side by side from array[at] on, float32 or int32. What lies behind them may be
    overwritten, up to array[at + LANES - 1]."""


@_named(_gather)
def gather(array: Any, at: Any) -> Any:
    """array[at[0]], array[at[1]] ... of ints that are not negative; float32 or int32."""


@_named(_gather_listed)
def gather_listed(array: Any, listed: Any, at: Any) -> Any:
    """array[listed[at]], array[listed[at + 1]] ...: the same, and cheaper, for places that are in memory anyway, of any
    integer type; they may be negative where there is something before the array."""


@_named(_every, prefer_literal=True)
def every(array: Any, at: Any, step: Any, first: Any) -> Any:
    """One column of LANES rows of ``step`` float32, both literals, from array[at] on: array[at + first], array[at +
    first + step] ... As many whole vectors as a row has columns are read."""


@_named(_prefetch)
def prefetch(array: Any, at: Any) -> Any:
    """Bring array[at] nearer, for it will be read soon; it may lie behind the array's end."""
