"""CDR written slowly, field by field, from the definitions alone: the reference that the library is held against.

Little-endian; a number is aligned to its size, counted from behind the four bytes of encapsulation; strings and
sequences begin with their length as uint32, a string's counts its closing zero.
"""

from __future__ import annotations

import struct
from typing import Any

FORMATS = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip


def plain_cdr(definitions: dict[str, Any], name: str, message: Any) -> bytes:
    """The message of type ``name``; ``definitions`` are a type store's."""
    body = bytearray()
    _write(definitions, (2, name), message, body)
    return b"\x00\x01\x00\x00" + bytes(body)


def _number(kind: str, value: Any, body: bytearray) -> None:
    size = struct.calcsize(FORMATS[kind])
    body += bytes(-len(body) % size)
    body += struct.pack("<" + FORMATS[kind], value)


def _write(definitions: dict[str, Any], description: Any, value: Any, body: bytearray) -> None:
    kind, about = int(description[0]), description[1]
    if kind == 1 and about[0] == "string":
        data = value.encode() + b"\x00"
        _number("uint32", len(data), body)
        body += data
    elif kind == 1:
        _number(about[0], value.item() if hasattr(value, "item") else value, body)
    elif kind == 2:
        fields = definitions[about][1]
        if not fields:  # an empty structure holds one byte
            body += b"\x00"
        for field, inner in fields:
            _write(definitions, inner, getattr(value, field), body)
    else:
        if kind == 4:
            _number("uint32", len(value), body)
        for one in value:
            _write(definitions, about[0], one, body)
