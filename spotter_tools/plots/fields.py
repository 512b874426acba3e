"""A message without a picture of its own: its fields, a line each."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np

from common.messages import Message

LINES, COLUMNS = 38, 110


def fields(axes: Any, message: Message) -> None:
    """As many as fit, nested names joined by dots; of an array its type, shape and extent."""
    lines = [
        textwrap.shorten(f"{name}: {value}", COLUMNS, placeholder=" ...")
        for name, value in _flat("", {name: getattr(message, name) for name in message.__struct_fields__})
    ]
    more = [f"... and {len(lines) - LINES} more"] if len(lines) > LINES else []
    axes.set_axis_off()
    axes.set_title(type(message).__name__)
    axes.text(0, 1, "\n".join(lines[:LINES] + more), family="monospace", fontsize=8, va="top", parse_math=False)


def _flat(name: str, value: object) -> Iterator[tuple[str, str]]:
    if isinstance(value, msgspec.Struct):
        value = {field: getattr(value, field) for field in value.__struct_fields__}
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _flat(f"{name}.{key}" if name else str(key), inner)
    elif isinstance(value, np.ndarray):
        extent = f", {value.min():g} to {value.max():g}" if value.size and value.dtype.kind in "iuf" else ""
        yield name, f"{value.dtype} {value.shape}{extent}"
    elif isinstance(value, bytes):
        yield name, f"{len(value)} bytes"
    else:
        yield name, str(value)
