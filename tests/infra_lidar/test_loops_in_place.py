"""Loops that are put down in place go over the numbers that Python's do."""

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from llvmlite import ir
from numba.core import types
from numba.core.registry import cpu_target
from numba.core.types import range_iter64_type, range_state64_type

import services.infra_lidar.jit  # noqa: F401  it is what changes the compiler


def to(a, b, c):
    numbers = [-1]
    for i in range(b):
        numbers.append(i)
    return numbers


def from_to(a, b, c):
    numbers = [-1]
    for i in range(a, b):
        numbers.append(i)
        i += 7  # the loop goes on all the same
    return numbers


def by_steps(a, b, c):
    numbers = [-1]
    for i in range(a, b, c):
        numbers.append(i)
    for i in range(b, a, -1):
        numbers.append(i)
    return numbers


def twice_over_one(a, b, c):
    numbers, both = [-1], range(a, b)
    for i in both:
        for j in both:
            numbers.append(i * j)
        if i == c:
            break
    else:
        numbers.append(len(both))
    return numbers


def either(a, b, c):
    numbers = [-1]
    for i in range(a, b) if c > 0 else range(b):
        if i == 2:
            continue
        numbers.append(i)
    return numbers


def changed_on_the_way(a, b, c):
    numbers = [-1]
    for i in range(b):
        b -= 2
        numbers.append(i + b)
    return numbers


FUNCTIONS = {one: numba.njit(one) for one in (to, from_to, by_steps, twice_over_one, either, changed_on_the_way)}
SMALL = st.integers(-5, 9)


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda one: one.__name__)
@given(a=SMALL, b=SMALL, c=SMALL.filter(bool))
@example(a=0, b=0, c=1)
@example(a=3, b=3, c=-1)
@settings(deadline=None, max_examples=60)
def test_numbers_are_pythons(function: Callable[..., Any], a: int, b: int, c: int):
    assert FUNCTIONS[function](a, b, c) == function(a, b, c)


@pytest.mark.parametrize("kind", [np.int8, np.int32, np.int64, np.uint8, np.uint32, np.uint64])
def test_limits_of_all_kinds(kind: Any):
    assert FUNCTIONS[from_to](kind(2), kind(5), 1) == [-1, 2, 3, 4]
    assert FUNCTIONS[to](0, kind(3), 1) == [-1, 0, 1, 2]


def test_a_step_of_nought_is_still_refused():
    with pytest.raises(ValueError, match="must not be zero"):
        FUNCTIONS[by_steps](0, 3, 0)


def test_a_loop_neither_divides_nor_asks_for_a_sign():
    context = cpu_target.target_context
    function = ir.Function(ir.Module(), ir.FunctionType(ir.VoidType(), [ir.IntType(64)]), "f")
    builder = ir.IRBuilder(function.append_basic_block())
    kind = types.Pair(types.int64, types.boolean)(range_iter64_type)
    with context.push_code_library(context.codegen().create_library("f")):
        counted = context.get_function(range, range_state64_type(types.int64))(builder, function.args)
        turns = context.get_function("getiter", range_iter64_type(range_state64_type))(builder, [counted])
        context.get_function("iternext", kind)(builder, [turns])
    opcodes = [one.opname for block in function.blocks for one in block.instructions]
    assert not {"srem", "sdiv", "br"} & set(opcodes)
