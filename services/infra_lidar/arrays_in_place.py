"""Arrays that are only read are taken apart where they are.

Numba puts an array's description, its address and shape, down in memory again whenever it is indexed, and takes all of
it apart whenever one comes or goes, to count references; its optimiser then finds out that nothing of this was needed.
What is left out here is what it would have removed: a twentieth of a cold start.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.runtime.context import NRTContext
from numba.np import arrayobj

_make_any_array = arrayobj.make_array


class _InPlace:
    """Before Numba's own way: a given value is put down in memory only when somebody asks for its address."""

    _given: Any = None

    def __init__(self, context: Any, builder: Any, value: Any = None, ref: Any = None) -> None:
        before = builder.block.instructions[: builder._anchor][-1:]
        if value is None or not before or isinstance(before[0], ir.PhiInstr):
            super().__init__(context, builder, value, ref)  # type: ignore[call-arg]
            return
        self._context, self._builder, self._be_type = context, builder, value.type
        self._datamodel = context.data_model_manager[self._fe_type]  # type: ignore[attr-defined]
        self._given, self._before = value, before[0]

    def __getitem__(self, index: int) -> Any:
        if self._given is None:
            return super().__getitem__(index)  # type: ignore[misc]
        return self._builder.extract_value(self._given, index)

    @property
    def shape(self) -> Any:
        """As one value; Numba's own way says also that no number in it is negative, which nobody makes use of."""
        return super().shape if self._given is None else super().__getattr__("shape")  # type: ignore[misc]

    def _getvalue(self) -> Any:
        return super()._getvalue() if self._given is None else self._given  # type: ignore[misc]

    def _setvalue(self, value: Any) -> None:
        self._put_down()
        super()._setvalue(value)  # type: ignore[misc]

    def _getpointer(self) -> Any:
        self._put_down()
        return super()._getpointer()  # type: ignore[misc]

    def _get_ptr_by_index(self, index: int) -> Any:
        self._put_down()
        return super()._get_ptr_by_index(index)  # type: ignore[misc]

    def _put_down(self) -> None:
        """Where the value was given: whoever asks now may be in a branch, and others come by another one."""
        if self._given is None:
            return
        builder, block = self._builder, self._builder.block
        following = block.instructions[builder._anchor :][:1]
        builder.position_at_start(builder.function.entry_basic_block)
        self._value = self._outer_ref = builder.alloca(self._given.type)
        builder.position_after(self._before)
        builder.store(self._given, self._value)
        self._given = None
        if following:
            builder.position_before(following[0])
        else:
            builder.position_at_end(block)


def _make_array(array_type: Any) -> Any:
    """How the description of an array is got at: that of an ordinary one in place."""
    return _in_place(array_type) if type(array_type) is types.Array else _make_any_array(array_type)


@cache
def _in_place(array_type: types.Array) -> Any:
    """Without asking each time whether something is wrapped around it."""
    plainly = {"_make_refs": cgutils.create_struct_proxy(array_type)._make_refs}
    return type("ArrayInPlace", (_InPlace, _make_any_array(array_type)), plainly)


def _counted_in(self: Any, builder: Any, numba_type: Any, value: Any) -> list[tuple[Any, Any]]:
    """What has its references counted in a value: types and pointers. Only what holds such is taken out of it."""
    models = self._context.data_model_manager
    found = (
        [(numba_type, models[numba_type].get_nrt_meminfo(builder, value))] if _is_counted(models[numba_type]) else []
    )
    for inner_type, taken_out in models[numba_type].traverse(builder):
        if _holds_counted(models[inner_type]):
            found += self.get_meminfos(builder, inner_type, taken_out(value))
    return found


@cache
def _is_counted(model: Any) -> bool:
    return bool(model.has_nrt_meminfo())


@cache
def _holds_counted(model: Any) -> bool:
    return bool(model.contains_nrt_meminfo())


def take_arrays_in_place() -> None:
    """Tell Numba."""
    arrayobj.make_array = _make_array
    NRTContext.get_meminfos = _counted_in  # type: ignore[method-assign]
