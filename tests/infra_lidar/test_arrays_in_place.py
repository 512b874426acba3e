"""What compiled code does with arrays that are taken apart in place is what numpy does."""

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import pytest
from llvmlite import ir
from numba.core import types
from numba.core.registry import cpu_target
from numba.core.runtime import _nrt_python, rtsys
from numba.np import arrayobj

import services.infra_lidar.jit  # noqa: F401  it is what changes the compiler

RECORD = np.dtype([("seen", np.int64), ("mean", np.float64, (3,))])


def in_one_branch(a: Any, yes: bool) -> Any:
    """The address of the description is asked for in a branch and, later, by everybody."""
    total = a[0, 0]
    if yes:
        total += a.ravel().sum()
    for row in a:
        total += row[-1]
    return total + a.T.shape[0] + a.ravel()[1]


def of_rows(a: Any, yes: bool) -> Any:
    total = 0.0
    for k in range(a.shape[0]):
        row = a[k] if yes else a[-k - 1, ::-1]
        total = 2.0 * total + row[1] + len(row)
    return total


def written(a: Any, yes: bool) -> Any:
    new = a.copy()
    if yes:
        new[1:, :2] = 3.0
    else:
        new[1:, :2] = a[1:, 1:3]
    new[-1, np.int64(1)] += new[0, np.uint8(2)]
    new[0] = new[1]
    return new


def over_all(a: Any, yes: bool) -> Any:
    """One after the other, and elementwise."""
    total = 0.0
    for one in a.flat:
        total = total * 0.5 + one
    if yes:
        total += (a * 2.0 + a[::-1]).sum() + np.sqrt(a).max()
    return total


ARRAYS = {
    "rows": np.arange(12.0).reshape(3, 4),
    "columns": np.asfortranarray(np.arange(12.0).reshape(3, 4)),
    "strided": np.arange(48.0).reshape(6, 8)[::2, 1::2],
    "single precision": np.arange(12, dtype=np.float32).reshape(3, 4),
}


@pytest.mark.parametrize("yes", [False, True])
@pytest.mark.parametrize("name", ARRAYS)
@pytest.mark.parametrize("function", [in_one_branch, of_rows, written, over_all], ids=lambda f: f.__name__)
def test_results_are_numpys(function: Callable[..., Any], name: str, yes: bool):
    np.testing.assert_allclose(numba.njit(function)(ARRAYS[name], yes), function(ARRAYS[name], yes), rtol=1e-6)


def test_records_are_read_and_written():
    @numba.njit
    def moved(a):
        for k in range(len(a)):
            a[k].mean[1] = a["seen"][k] + a[k]["mean"][0]
        return a[1].mean

    made = np.zeros(3, RECORD)
    made["seen"], made["mean"][:, 0] = (1, 2, 3), 0.5
    assert moved(made).tolist() == [0.5, 2.5, 0.0]
    assert made["mean"][:, 1].tolist() == [1.5, 2.5, 3.5]


def test_memory_is_given_back():
    @numba.njit
    def pieces(n):
        kept = (np.zeros(n), [np.ones(k) for k in range(n)])
        view = kept[0][1:]
        return view, kept[1][-1]

    _nrt_python.memsys_enable_stats()
    before = rtsys.get_allocation_stats()
    for _ in range(5):
        pieces(4)
    after = rtsys.get_allocation_stats()
    assert after.alloc - before.alloc == after.free - before.free > 0
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free > 0


def test_reading_a_number_puts_nothing_down():
    """An index costs a few instructions, none of which writes."""
    context, array = cpu_target.target_context, types.Array(types.float32, 1, "C")
    description, index = context.get_value_type(array), ir.IntType(64)
    function = ir.Function(ir.Module(), ir.FunctionType(ir.VoidType(), [description, index]), "f")
    builder = ir.IRBuilder(function.append_basic_block())
    builder.add(function.args[1], function.args[1])  # a function begins with what is made of its arguments
    signature = types.float32(array, types.int64)
    arrayobj.getitem_arraynd_intp(context, builder, signature, function.args)
    opcodes = [one.opname for one in function.entry_basic_block.instructions]
    assert "store" not in opcodes
    assert "alloca" not in opcodes


def test_a_value_whose_address_is_asked_for_in_a_branch_is_there_for_all():
    context, array = cpu_target.target_context, types.Array(types.float32, 1, "C")
    function = ir.Function(
        ir.Module(), ir.FunctionType(ir.VoidType(), [context.get_value_type(array), ir.IntType(1)]), "f"
    )
    entry = function.append_basic_block()
    builder = ir.IRBuilder(entry)
    condition = builder.not_(function.args[1])
    described = arrayobj.make_array(array)(context, builder, function.args[0])
    last = builder.add(ir.Constant(ir.IntType(8), 1), ir.Constant(ir.IntType(8), 1))
    with builder.if_then(condition):
        place = described._getpointer()
        after = builder.load(place)
    (stored,) = (one for block in function.blocks for one in block.instructions if one.opname == "store")
    assert stored.operands == [function.args[0], place]
    assert entry.instructions.index(condition) < entry.instructions.index(stored) < entry.instructions.index(last)
    assert after.parent is not entry  # whoever asked goes on where they were
    assert entry.instructions[-1].opname == "br"
