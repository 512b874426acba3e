"""Frames of a pcapng capture, each with its own interface's link layer and clock (draft-ietf-opsawg-pcapng).

dpkt reads the container too, but knows only the first interface's.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

MAGIC = b"\x0a\x0d\x0d\x0a"  # a section's first block, in either order of bytes
_BYTE_ORDERS = {b"\x4d\x3c\x2b\x1a": "<", b"\x1a\x2b\x3c\x4d": ">"}
_INTERFACE, _OLD_PACKET, _SIMPLE_PACKET, _PACKET = 1, 2, 3, 6
_HEADS = {_PACKET: "IIII", _OLD_PACKET: "HHIII"}  # interface, (drops,) time in two halves, bytes captured
_FRAME_AT = 20
_RESOLUTION, _OFFSET = 9, 14  # options of an interface
_LARGEST_BLOCK = 1 << 26


class Record(NamedTuple):
    """A frame of a capture. link: number of its link layer, as in pcap-linktype(7)."""

    link: int
    stamp_ns: int
    frame: bytes


class _Interface(NamedTuple):
    link: int
    ticks_per_s: int = 1_000_000
    offset_s: int = 0


class PcapngReader:
    """Iterate it for the records. ``unstamped`` counts simple packet blocks, which say no time and are left out.

    Raises:
        ValueError: no such capture, or damaged before its first interface.
        EOFError: cut before its first interface.
        struct.error: damaged there.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream, self._order = stream, ""
        self._interfaces: list[_Interface] = []
        self.unstamped = 0
        while not self._interfaces:
            if self._next() is None:
                raise EOFError("no interface is described")

    def __iter__(self) -> Iterator[Record]:
        while (block := self._next()) is not None:
            kind, body = block
            self.unstamped += kind == _SIMPLE_PACKET
            if kind in _HEADS:
                yield self._record(kind, body)

    def _record(self, kind: int, body: bytes) -> Record:
        number, *_, high, low, length = struct.unpack_from(self._order + _HEADS[kind], body)
        frame = body[_FRAME_AT : _FRAME_AT + length]
        if number >= len(self._interfaces) or len(frame) < length:
            raise ValueError(f"a packet of {length} bytes of interface {number}: one of them cannot be")
        here = self._interfaces[number]
        return Record(here.link, here.offset_s * 10**9 + (high << 32 | low) * 10**9 // here.ticks_per_s, frame)

    def _next(self) -> tuple[int, bytes] | None:
        """(type, body) of the next block; sections and interfaces are kept in mind. None at the end."""
        head = self._stream.read(8)
        if not head:
            return None
        body = b""
        if head.startswith(MAGIC):
            body = self._stream.read(4)
            self._order, self._interfaces = _BYTE_ORDERS.get(body, ""), []
        if not self._order or len(head) < 8:
            raise ValueError("no whole pcapng block")
        kind, length = struct.unpack(self._order + "II", head)
        left = length - len(head) - len(body)
        if left < 4 or length % 4 or length > _LARGEST_BLOCK:
            raise ValueError(f"a block of {length} bytes")
        rest = self._stream.read(left)
        if len(rest) < left:
            raise EOFError(f"a block of {length} bytes is cut")
        if kind == _INTERFACE:
            self._interfaces.append(_interface(rest[:-4], self._order))
        return kind, rest[:-4]  # behind it is the length again


def _interface(body: bytes, order: str) -> _Interface:
    """From the body of its block: link layer, snap length, options of (code, length, value to a multiple of 4)."""
    found, at = _Interface(*struct.unpack_from(order + "H", body)), 8
    while at + 4 <= len(body):
        code, length = struct.unpack_from(order + "HH", body, at)
        at += 4
        if code == _RESOLUTION and length == 1:
            exponent = body[at] & 0x7F
            found = found._replace(ticks_per_s=2**exponent if body[at] & 0x80 else 10**exponent)
        elif code == _OFFSET and length == 8:
            found = found._replace(offset_s=struct.unpack_from(order + "q", body, at)[0])
        at += length + -length % 4
    return found
