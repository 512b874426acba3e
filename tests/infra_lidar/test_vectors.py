"""Vectors in kernels against the same on numpy arrays, lane by lane, on this processor's vectors and on others'."""

import operator
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from llvmlite import binding
from numba.core.errors import TypingError
from numba.core.registry import cpu_target
from numba.core.target_extension import get_local_target
from numba.core.utils import order_by_target_specificity

from services.infra_lidar.jit import ASKED_FIRST
from services.infra_lidar.vectors import (
    LANES,
    bit_count,
    bits,
    every,
    first_bit,
    floor,
    fma,
    gather,
    gather_listed,
    lane_count,
    lane_max,
    lane_min,
    lane_sum,
    lanes,
    larger,
    load,
    load_of_row,
    magnitude,
    ones,
    root,
    select,
    smaller,
    splat,
    store,
    store_chosen,
    unbits,
    whole,
)

FLOATS = arrays(np.float32, (2, LANES), elements=st.floats(-1000, 1000, width=32))
INTS = arrays(np.int32, (2, LANES), elements=st.integers(-1000, 1000))


@numba.njit(error_model="numpy")
def of_floats(a, b, number, out, flags, counts):
    x, y = load(a, 0), load(b, 0)
    store(out[0], 0, x + y)
    store(out[1], 0, x - number)
    store(out[2], 0, number * y)
    store(out[3], 0, x / y)
    store(out[4], 0, fma(x, y, number))
    store(out[5], 0, root(magnitude(x)))
    store(out[6], 0, floor(x))
    store(out[7], 0, smaller(x, y))
    store(out[8], 0, larger(x, number))
    store(out[9], 0, select(x < y, x, number))
    store(out[10], 0, unbits(bits(x)))
    store(out[11], 0, splat(number))
    store(flags[0], 0, x < y)
    store(flags[1], 0, x <= number)
    store(flags[2], 0, x > y)
    store(flags[3], 0, x >= y)
    store(flags[4], 0, x == y)
    store(flags[5], 0, x != y)
    store(flags[6], 0, (x < y) & ~(x > number) | (y == number) ^ (x < number))
    store(counts[0], 0, ones(x < y))
    store(counts[1], 0, whole(x))
    return lane_sum(x), lane_min(x), lane_max(y), lane_count(x < y)


@given(FLOATS, st.floats(-1000, 1000, width=32))
@settings(deadline=None, max_examples=60)
def test_floats_lane_by_lane(values, number):
    a, b = values
    n = np.float32(number)
    out, flags, counts = np.zeros((12, LANES), np.float32), np.zeros((7, LANES), bool), np.zeros((2, LANES), np.int32)
    total, least, most, count = of_floats(a, b, n, out, flags, counts)
    with np.errstate(all="ignore"):
        expected = [
            a + b, a - n, n * b, a / b, (a.astype(np.float64) * b + n).astype(np.float32), np.sqrt(np.abs(a)),
            np.floor(a), np.minimum(a, b), np.maximum(a, n), np.where(a < b, a, n), a, np.full(LANES, n),
        ]  # fmt: skip
    np.testing.assert_allclose(out, expected, rtol=1e-6, atol=1e-6)
    compared = [a < b, a <= n, a > b, a >= b, a == b, a != b, ((a < b) & ~(a > n)) | ((b == n) ^ (a < n))]
    assert np.array_equal(flags, compared)
    assert np.array_equal(counts, [a < b, np.trunc(a)])
    assert total == pytest.approx(a.sum(dtype=np.float64), abs=0.01)
    assert (least, most, count) == (a.min(), b.max(), (a < b).sum())


@numba.njit(error_model="numpy")
def of_ints(a, b, number, shorts, out, flags):
    x, y = load(a, 0), load(b, 0)
    store(out[0], 0, x + y)
    store(out[1], 0, x - number)
    store(out[2], 0, x * y)
    store(out[3], 0, x & y)
    store(out[4], 0, x | number)
    store(out[5], 0, x ^ y)
    store(out[6], 0, ~x)
    store(out[7], 0, x << 3)
    store(out[8], 0, x >> 2)
    store(out[9], 0, smaller(x, y))
    store(out[10], 0, larger(x, number))
    store(out[11], 0, lanes() + number)
    store(shorts, 0, x)
    store(out[12], 0, load(shorts, 0))
    store(flags[0], 0, x < y)
    store(flags[1], 0, x == number)
    return lane_sum(x), lane_min(x), lane_max(y)


@given(INTS, st.integers(-1000, 1000))
@settings(deadline=None, max_examples=60)
def test_ints_lane_by_lane(values, number):
    a, b = values
    n = np.int32(number)
    shorts, out, flags = np.zeros(LANES, np.int16), np.zeros((13, LANES), np.int32), np.zeros((2, LANES), bool)
    total, least, most = of_ints(a, b, n, shorts, out, flags)
    expected = [
        a + b, a - n, a * b, a & b, a | n, a ^ b, ~a, a << 3, a >> 2, np.minimum(a, b), np.maximum(a, n),
        np.arange(LANES) + n, a,
    ]  # fmt: skip
    assert np.array_equal(out, expected)
    assert np.array_equal(shorts, a)
    assert np.array_equal(flags, [a < b, a == n])
    assert (total, least, most) == (a.sum(), a.min(), b.max())


@numba.njit(error_model="numpy")
def comparisons(a, flags):
    x = load(a, 0)
    store(flags[0], 0, x < 1.0)
    store(flags[1], 0, x >= 1.0)
    store(flags[2], 0, x == x)
    store(flags[3], 0, x != x)


def test_no_comparison_holds_with_what_is_no_number():
    flags = np.ones((4, LANES), bool)
    comparisons(np.full(LANES, np.nan, np.float32), flags)
    assert not flags.any()


@numba.njit(error_model="numpy")
def from_memory(table, at, shorts, out, rows):
    store(out[0], 0, gather(table, load(at, 0)))
    store(out[1], 0, gather_listed(table, at, 0))
    store(out[2], 0, gather_listed(table[1:], shorts, 0))
    store(rows[0], 0, every(table, 2, 3, 1))
    store(rows[1], 0, every(table, 2, 4, 3))
    store(rows[2], 0, every(table, 2, 5, 0))
    store(rows[3], 0, every(table, 2, 6, 4))


@given(arrays(np.int32, LANES, elements=st.integers(0, 99)))
@settings(deadline=None, max_examples=30)
def test_here_and_there_and_every_column(at):
    table = np.arange(8 * LANES + 100, dtype=np.float32) * 1.5
    out, rows = np.zeros((3, LANES), np.float32), np.zeros((4, LANES), np.float32)
    from_memory(table, at, (at - 1).astype(np.int16), out, rows)  # -1 is before the array's first
    assert np.array_equal(out, [table[at]] * 3)
    for row, (step, first) in zip(rows, ((3, 1), (4, 3), (5, 0), (6, 4)), strict=True):
        assert np.array_equal(row, table[2 + first :: step][:LANES])


@numba.njit(error_model="numpy")
def chosen(values, numbers, flags, kept, kept_numbers):
    store_chosen(kept, 1, load(values, 0), load(flags, 0))
    store_chosen(kept_numbers, 1, load(numbers, 0), load(flags, 0))


@given(arrays(bool, LANES), INTS)
@settings(deadline=None, max_examples=60)
def test_chosen_lanes_are_stored_side_by_side(flags, values):
    numbers, floats = values[0], values[1].astype(np.float32)
    kept, kept_numbers = np.full(LANES + 2, -7, np.float32), np.full(LANES + 2, -7, np.int32)
    chosen(floats, numbers, flags, kept, kept_numbers)
    count = flags.sum()
    assert np.array_equal(kept[1 : 1 + count], floats[flags])
    assert np.array_equal(kept_numbers[1 : 1 + count], numbers[flags])
    assert (kept[0], kept[-1], kept_numbers[0], kept_numbers[-1]) == (-7, -7, -7, -7)


@numba.njit
def of_words(word):
    return first_bit(word), bit_count(word)


@given(st.integers(1, 2**64 - 1))
@settings(deadline=None, max_examples=60)
def test_bits_of_words(word):
    assert of_words(np.uint64(word)) == ((word & -word).bit_length() - 1, word.bit_count())


@pytest.mark.parametrize("kind", [np.float32, np.int32])
def test_a_vector_of_a_row(kind):
    @numba.njit
    def taken(values, row, at):
        out = np.empty(LANES, values.dtype)
        store(out, 0, load_of_row(values, row, at))
        return out

    values = np.arange(3 * (2 * LANES + 5)).reshape(3, -1).astype(kind)
    for row in range(3):
        for at in (0, 3, LANES + 5):
            np.testing.assert_array_equal(taken(values, row, np.int32(at)), values[row, at : at + LANES])


def test_what_is_not_side_by_side_is_refused_when_it_is_compiled():
    @numba.njit
    def first(values):
        return lane_sum(load(values, 0))

    every_second = np.zeros((2 * LANES, 2), np.float32)[:, 0]
    with pytest.raises(TypeError, match="side by side"):
        first(every_second)


def test_floats_do_not_become_ints_unasked():
    @numba.njit
    def mixed(values):
        return lane_sum(load(values, 0) + 0.5)

    with pytest.raises(TypingError):
        mixed(np.zeros(LANES, np.int32))


AS_ANOTHER_PROCESSOR = """
import sys
from llvmlite import binding
own = binding.get_host_cpu_features
binding.get_host_cpu_features = lambda: binding.FeatureMap({features})
import services.infra_lidar.vector_types as types
binding.get_host_cpu_features = own
assert types.LANES == {lanes}
import pytest
sys.exit(pytest.main(["-q", "-p", "no:cacheprovider", "-k", "not other_processors", {path!r}]))
"""


HAS_SIXTEEN = bool(binding.get_host_cpu_features().get("avx512f"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("features", "lanes"),
    [
        pytest.param(
            {"avx512f": True}, 16,
            marks=pytest.mark.skipif(not HAS_SIXTEEN, reason="sixteen lanes are looked up by AVX-512, not here"),
        ),
        ({}, 8),
    ],
)  # fmt: skip
def test_the_same_on_other_processors_vectors(features, lanes):
    """Sixteen lanes where kernels are compiled for fewer, too, and eight without instructions for choosing."""
    code = AS_ANOTHER_PROCESSOR.format(features=features, lanes=lanes, path=__file__)
    root_folder = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", code], cwd=root_folder, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("symbol", "others"),
    [
        *((symbol, 5) for symbol in (operator.getitem, operator.add, operator.lt)),
        *((symbol, 1) for symbol in (min, max, np.empty, np.zeros, np.ones, np.full, np.arange)),
    ],
)
def test_the_compiler_asks_for_our_kinds_first(symbol: Any, others: int) -> None:
    context = cpu_target.typing_context
    context.refresh()
    known = context.resolve_value_type(symbol).templates
    asked = [
        t.metadata == ASKED_FIRST["metadata"] for t in order_by_target_specificity(get_local_target(context), known)
    ]
    assert asked == sorted(asked, reverse=True)
    assert asked.count(True) >= 1
    assert asked.count(False) >= others
