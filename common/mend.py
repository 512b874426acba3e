"""Brings a message back inside its own schema, so that one number out of bounds does not hide all the others.

A number beyond a limit becomes the limit, a text that is too long is cut, NaN becomes None where None is allowed.
An entry of a table that holds NaN where a number is required is left out. Nothing is made up: NaN anywhere else stays,
and so do a wrong type and a list that is too long; such a message is not sent.
"""

from __future__ import annotations

import math
from typing import Any

from msgspec import inspect


def mend(document: Any, message_type: Any) -> Any:
    """A decoded msgpack document of dictionaries and lists -> the same, brought into the bounds of ``message_type``."""
    return _mend(document, inspect.type_info(message_type))


def _mend(value: Any, kind: inspect.Type) -> Any:
    match kind:
        case inspect.Metadata():
            return _mend(value, kind.type)
        case inspect.UnionType():
            return _mend_union(value, kind)
        case inspect.StructType() if isinstance(value, dict):
            kinds = {field.encode_name: field.type for field in kind.fields}
            return {name: _mend(inner, kinds[name]) if name in kinds else inner for name, inner in value.items()}
        case inspect.DictType() if isinstance(value, dict):
            table = {_mend(key, kind.key_type): _mend(inner, kind.value_type) for key, inner in value.items()}
            return {key: inner for key, inner in table.items() if not _has_nan(inner)}
        case inspect.ListType() | inspect.VarTupleType() if isinstance(value, list | tuple):
            return [_mend(inner, kind.item_type) for inner in value]
        case inspect.TupleType() if isinstance(value, list | tuple) and len(value) == len(kind.item_types):
            return [_mend(inner, item) for inner, item in zip(value, kind.item_types, strict=True)]
        case inspect.FloatType() | inspect.IntType() if isinstance(value, int | float):
            return _within(value, kind)
        case inspect.StrType() if isinstance(value, str) and kind.max_length is not None:
            return value[: kind.max_length]
        case _:
            return value


def _mend_union(value: Any, kind: inspect.UnionType) -> Any:
    """None where the number is NaN and may be missing; a choice between several types stays as it is."""
    if isinstance(value, float) and math.isnan(value) and kind.includes_none:
        return None
    others = [one for one in kind.types if not isinstance(one, inspect.NoneType)]
    return _mend(value, others[0]) if value is not None and len(others) == 1 else value


def _has_nan(value: Any) -> bool:
    match value:
        case float():
            return math.isnan(value)
        case dict():
            return any(map(_has_nan, value.values()))
        case list():
            return any(map(_has_nan, value))
        case _:
            return False


def _within(value: float, kind: inspect.FloatType | inspect.IntType) -> float:
    """The nearest allowed number; NaN stays NaN."""
    if isinstance(value, float) and math.isnan(value):
        return value
    if kind.ge is not None and value < kind.ge:
        return kind.ge
    if kind.le is not None and value > kind.le:
        return kind.le
    return value
