"""References are counted where a function makes or returns arrays, and nowhere else."""

import gc
import sys
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import pytest
from numba.core import types
from numba.core.compiler import run_frontend
from numba.core.registry import cpu_target
from numba.core.runtime import _nrt_python, rtsys
from numba.core.typed_passes import type_inference_stage

import services.infra_lidar.jit  # noqa: F401  it is what changes the compiler
from services.infra_lidar.references_on_demand import counted_values, lent

TABLE = np.arange(4.0)


def looks(a, k):
    part = a[k:]
    for row in part:
        k += row[0]
    flat = a.reshape(a.size)
    return flat[1:][0] + k


def makes(a, k):
    made = np.zeros(len(a))
    part = made[k:]
    part[0] = a[0, 0]
    return part.sum()


def one_or_the_other(a, k):
    rows = a[0]
    if k > 1:
        rows = a[1] + 1.0
    return rows[0]


def turns_round(a, k):
    rows, others = a[0], a[1]
    for _ in range(k):
        rows, others = others, rows[:]
    return rows[0] + TABLE[0]


def returns_a_part(a, k):
    part = a[k]
    return part


def chosen_by_places(a, k):
    return a[np.array([0, k])].sum()


def moves_over(a, k):
    a[1:] = a[:-1]  # as if all were read before any is written
    a[k % 3] = a[0]
    return a[2].sum()


def of_a_list(a, k):
    kept = [a[0], a[1]]
    first = kept[0]
    return first[k]


def typed(function: Callable[..., Any]) -> tuple[dict[str, list[Any]], dict[str, types.Type]]:
    """The counted values of a function of a matrix and an int, and the types of its names."""
    target = cpu_target
    target.target_context.refresh()
    code = run_frontend(function)
    kinds = type_inference_stage(
        target.typing_context, target.target_context, code, (types.float64[:, ::1], types.int64), None
    ).typemap
    return counted_values(code, kinds), kinds


@pytest.mark.parametrize(
    ("function", "names_lent", "names_own"),
    [
        (looks, {"a", "part", "row", "flat"}, set()),
        (makes, {"a"}, {"made", "part"}),
        (one_or_the_other, {"a"}, {"rows"}),
        (turns_round, {"a", "rows", "others"}, set()),
        (returns_a_part, {"a", "part"}, set()),  # what is returned is a reference of its own, a "cast"
        (of_a_list, {"a"}, {"kept", "first"}),
        (moves_over, {"a"}, set()),
        (chosen_by_places, {"a"}, set()),
    ],
    ids=lambda one: getattr(one, "__name__", ""),
)
def test_who_holds_what(function: Callable[..., Any], names_lent: set[str], names_own: set[str]):
    counted, kinds = typed(function)
    found = lent(counted, kinds)
    known = {name for name in counted if not name.startswith("$")}
    assert {name for name in found if not name.startswith("$")} == names_lent
    assert known - names_lent == names_own
    returned = {name for name, values in counted.items() if None in values}
    assert not returned & found


@pytest.mark.parametrize(
    "function", [looks, makes, one_or_the_other, turns_round, returns_a_part, chosen_by_places, of_a_list, moves_over],
    ids=lambda one: one.__name__,
)  # fmt: skip
@pytest.mark.parametrize("k", [0, 1, 2])
def test_results_are_pythons_and_everything_is_given_back(function: Callable[..., Any], k: int):
    compiled, a = numba.njit(function), np.arange(12.0).reshape(3, 4)
    of_compiled, of_python = a.copy(), a.copy()
    np.testing.assert_array_equal(compiled(of_compiled, k), function(of_python, k))
    np.testing.assert_array_equal(of_compiled, of_python)
    _nrt_python.memsys_enable_stats()
    gc.collect()
    held, before = sys.getrefcount(a), rtsys.get_allocation_stats()
    for _ in range(5):
        compiled(a, k)
    after = rtsys.get_allocation_stats()
    assert sys.getrefcount(a) == held
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free


def test_what_is_returned_outlives_what_it_is_a_part_of():
    @numba.njit
    def inside(a, k):
        return a[k:]

    @numba.njit
    def outside(k):
        return inside(np.arange(20.0) + k, k), inside(np.ones(7), k)

    part, ones = outside(3)
    junk = [np.full(20, 7.0) for _ in range(100)]
    assert part.tolist() == [k + 3.0 for k in range(3, 20)]
    assert ones.tolist() == [1.0] * 4
    assert len(junk) == 100
    whole = np.arange(5.0)
    rest = numba.njit(lambda a, k: a[k:])(whole, 2)
    del whole
    gc.collect()
    assert rest.tolist() == [2.0, 3.0, 4.0]


def test_looking_costs_no_counting():
    @numba.njit
    def largest(row):
        most = row[0]
        for one in row:
            most = max(most, one)
        return most

    @numba.njit
    def compiled(a, k):
        total, rest = 0.0, a[k:]
        while len(rest) > 0 and total < 100.0:
            total += largest(rest[0]) + largest(a[k][1:])
            rest = rest[1:]
        return total

    compiled(np.ones((3, 4)), 1)
    (code,) = compiled.inspect_llvm().values()
    assert "call void @NRT_incref" not in code
