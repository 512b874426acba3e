"""Rows of points to planar columns, sixteen rows at a time, and picking some of them.

Read one by one, interleaved rows cost more than what is computed from them: the compiler does not see that sixteen
rows of five are five whole vectors to be shuffled. So the shuffle is spelled out, as generic LLVM that fits any
processor. Rows of other widths, and the last few, are read one by one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from services.infra_lidar.jit import kernel

LANES = 16


def _sixteen(width: int, columns: tuple[int, ...]) -> Any:
    """An intrinsic (flat, at, to, out): out[k, to : to + 16] = flat[at + columns[k] + width * (0 .. 15)], float32."""

    @intrinsic
    def take(typing_context, flat, at, to, out):  # type: ignore[no-untyped-def]
        def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
            rows = ir.VectorType(ir.FloatType(), LANES * width)
            lanes = ir.VectorType(ir.FloatType(), LANES)
            source = context.make_array(signature.args[0])(context, builder, arguments[0])
            target = context.make_array(signature.args[3])(context, builder, arguments[3])
            room = builder.extract_value(target.shape, 1)
            whole = builder.load(builder.bitcast(builder.gep(source.data, [arguments[1]]), rows.as_pointer()), align=4)
            for k, column in enumerate(columns):
                index = [width * lane + column for lane in range(LANES)]
                mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), index)
                chosen = builder.shuffle_vector(whole, ir.Constant(rows, ir.Undefined), mask)
                place = builder.add(arguments[2], builder.mul(room, room.type(k)))
                builder.store(chosen, builder.bitcast(builder.gep(target.data, [place]), lanes.as_pointer()), align=4)
            return context.get_dummy_value()

        return types.void(flat, types.int64, types.int64, out), generate

    return take


_rows_of_3, _rows_of_4 = _sixteen(3, (0, 1, 2)), _sixteen(4, (0, 1, 2))
_rows_of_5 = _sixteen(5, (0, 1, 2, 4))


@kernel
def planar(points, first, n, out):  # type: ignore[no-untyped-def]
    """out (4, n or more) float32: x, y, z of the rows first .. first + n - 1 of points (N, 3+) float32, and their fifth
    column, the ring, where they have one."""
    width = points.shape[1]
    flat = points.reshape(points.size)
    whole = n - n % LANES if 3 <= width <= 5 else 0
    for i in range(0, whole, LANES):
        at = (first + i) * width
        if width == 5:
            _rows_of_5(flat, at, i, out)
        elif width == 4:
            _rows_of_4(flat, at, i, out)
        else:
            _rows_of_3(flat, at, i, out)
    for i in range(whole, n):
        for k in range(3):
            out[k, i] = points[first + i, k]
        if width > 4:
            out[3, i] = points[first + i, 4]


@kernel
def pick_flagged(flag, words, n, pick):  # type: ignore[no-untyped-def]
    """Indices (M,) int32 of the set ones among n flags (n rounded up to 8,) uint8, eight at a time; returns M.

    words is ``flag`` seen as uint64. pick has room for n + 8.
    """
    m = 0
    for w in range((n + 7) // 8):
        if words[w] != 0:  # what is wanted comes in runs, and what is not in longer ones
            for i in range(8 * w, 8 * w + 8):  # without branches: the next one overwrites what is not wanted
                pick[m] = i
                m += flag[i]
    return m


@kernel
def copy_picked(values, picked, out):  # type: ignore[no-untyped-def]
    """out (M,): the picked ones of the values."""
    for j in range(len(picked)):
        out[j] = values[np.uint32(picked[j])]


@kernel
def shift_picked(picked, by, out):  # type: ignore[no-untyped-def]
    """out (M,) int32: the picked indices in the whole frame, of which the block begins at ``by``."""
    for j in range(len(picked)):
        out[j] = picked[j] + np.int32(by)
