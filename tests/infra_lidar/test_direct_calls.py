"""Numbers and arrays put down in place are those of Python and numpy."""

import operator
from collections.abc import Callable
from contextlib import suppress
from itertools import product
from typing import Any

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba.core import types
from numba.core.errors import NumbaError
from numba.core.registry import cpu_target
from numba.core.runtime import _nrt_python, rtsys

from services.infra_lidar import jit

RECORD = np.dtype([("seen", np.int64), ("mean", np.float64, (3,))])
INTS, FLOATS = st.integers(-(2**53), 2**53), st.floats(width=32)


@numba.njit
def both(a, b):
    return min(a, b), max(a, b)


def same(got: Any, expected: Any) -> bool:
    return bool(got == expected or (np.isnan(got) and np.isnan(expected)))


@given(st.one_of(INTS, FLOATS), st.one_of(INTS, FLOATS))
@settings(deadline=None)
def test_smaller_and_larger_are_pythons(a, b):
    """Also where one is no number: then it depends on which is the first."""
    for got, expected in zip(both(a, b), (min(a, b), max(a, b)), strict=True):
        assert same(got, expected)


@given(FLOATS, FLOATS)
@settings(deadline=None)
def test_single_precision_stays_single(a, b):
    low, high = both(np.float32(a), np.float32(b))
    assert same(low, min(a, b))
    assert same(high, max(a, b))


def test_more_than_two_numbers_are_left_to_the_compiler():
    @numba.njit
    def of_three(a, b, c):
        return min(a, b, c), max((a, b, c))

    assert of_three(3, 1.5, 2) == (1.5, 3.0)


NEW: list[Callable[[int], Any]] = [
    lambda n: np.zeros(n),
    lambda n: np.zeros((n, 2), np.int32),
    lambda n: np.zeros(n, np.bool_),
    lambda n: np.zeros(n, dtype=np.int16),
    lambda n: np.zeros(n, RECORD),
    lambda n: np.ones(n),
    lambda n: np.ones(n, np.bool_),
    lambda n: np.ones((2, n), np.int8),
    lambda n: np.full(n, 7),
    lambda n: np.full(n, 0.5),
    lambda n: np.full((3, n), np.nan),
    lambda n: np.full(n, 2.9, np.int32),
    lambda n: np.full((n, 2), -1, np.int8),
    lambda n: np.full(n, np.float32(0.1) / np.float32(3.0), np.float32),
    lambda n: np.arange(n),
    lambda n: np.arange(n, dtype=np.int32),
]


@pytest.mark.parametrize("make", NEW)
@pytest.mark.parametrize("n", [0, 1, 37])
def test_new_arrays_are_numpys(make, n):
    got, expected = numba.njit(make)(n), make(n)
    assert (got.dtype, got.shape, got.flags.c_contiguous) == (expected.dtype, expected.shape, True)
    assert got.tobytes() == expected.tobytes()


@pytest.mark.parametrize(
    ("make", "dtype", "shape"),
    [
        (lambda n: np.empty(n), np.float64, (5,)),
        (lambda n: np.empty((n, 4), np.uint8), np.uint8, (5, 4)),
        (lambda n: np.empty(np.int32(n), RECORD), RECORD, (5,)),
    ],
)
def test_empty_arrays_can_be_written(make, dtype, shape):
    got = numba.njit(make)(5)
    got[:] = np.ones(shape, np.uint8).astype(dtype)
    assert (got.dtype, got.shape) == (dtype, shape)


@pytest.mark.parametrize("make", [lambda n: np.zeros(n), lambda n: np.empty((2, n)), lambda n: np.full(n, 1.0)])
def test_arrays_of_less_than_nothing_are_refused(make):
    with pytest.raises(ValueError, match="negative dimensions"):
        numba.njit(make)(-1)


def test_counting_to_less_than_nothing_is_counting_to_nothing():
    assert numba.njit(lambda n: np.arange(n))(-3).tolist() == []


def test_memory_is_given_back():
    @numba.njit
    def total(n):
        some = np.arange(n)
        return np.full(n, 2).sum() + some.sum()

    assert total(100) == 5150
    _nrt_python.memsys_enable_stats()
    before = rtsys.get_allocation_stats()
    for _ in range(3):
        total(100)
    after = rtsys.get_allocation_stats()
    assert after.alloc - before.alloc == after.free - before.free == 6


def test_kernels_are_what_this_is_for():
    @jit.inner
    def halves(n):
        return np.full(n, 0.5)

    @numba.njit
    def total(n):
        return halves(n).sum() + max(n, 3)

    assert total(2) == 4.0


KINDS = (types.boolean, types.uint8, types.int32, types.uint32, types.int64, types.uint64, types.float32, types.float64)
ARITHMETIC = (operator.add, operator.sub, operator.mul, operator.truediv, operator.floordiv, operator.mod)
ORDER_AND_BITS = (operator.lt, operator.le, operator.gt, operator.ge, operator.and_, operator.or_, operator.xor)


def typed_by(templates: list[Any], args: tuple[Any, ...]) -> Any:
    """The first signature that one of them knows."""
    for template in templates:
        with suppress(NumbaError):
            if (found := template(cpu_target.typing_context).apply(args, {})) is not None:
                return found
    return None


@pytest.mark.parametrize("symbol", ARITHMETIC + ORDER_AND_BITS)
def test_asking_for_numbers_first_makes_no_other_numbers_of_them(symbol):
    context = cpu_target.typing_context
    context.refresh()
    known = context.resolve_value_type(symbol).templates
    first = [template for template in known if template.metadata == jit.ASKED_FIRST["metadata"]]
    others = [template for template in known if template not in first]
    assert first
    assert others
    for args in product(KINDS, KINDS):
        assert typed_by(first + others, args) == typed_by(others, args), args
    array = types.Array(types.float32, 1, "C")
    for args in ((array, types.float64), (types.int32, array), (array, array)):
        assert typed_by(first, args) is None, args
