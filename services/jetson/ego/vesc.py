"""The VESC's serial packets, as far as COMM_GET_VALUES needs them. Pure.

Source: VESC firmware, ``comm/packet.c`` (framing), ``comm/commands.c`` (COMM_GET_VALUES). Numbers are big-endian.

    2 <length> <payload> <CRC-16> 3          payload up to 255 bytes
    3 <length, 2 bytes> <payload> <CRC-16> 3
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from typing import NamedTuple

from services.jetson.ego.measurement import Rejected

COMM_GET_VALUES = 4
ERPM_AT, VOLTAGE_AT, FAULT_AT = 23, 27, 53  # in the payload
MIN_VALUES = FAULT_AT + 1
MAX_PAYLOAD = 1024
SHORT, LONG, END = 2, 3, 3


class Values(NamedTuple):
    """What is used of the answer."""

    erpm: int  # electrical revolutions per minute, negative in reverse
    battery_v: float
    fault: int  # 0 = none


def packet(payload: bytes) -> bytes:
    """A payload as the VESC's own tools frame it."""
    length = bytes((SHORT, len(payload))) if len(payload) < 256 else struct.pack(">BH", LONG, len(payload))
    return length + payload + struct.pack(">HB", crc_hqx(payload, 0), END)


REQUEST = packet(bytes((COMM_GET_VALUES,)))


class VescReader:
    """Bytes as they come to values; anything else is rejected by name."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Values | Rejected]:
        """The answers that are complete now."""
        self._buffer += data
        found: list[Values | Rejected] = []
        while self._buffer:
            if self._buffer[0] not in (SHORT, LONG):
                del self._buffer[0]
                continue
            header = self._buffer[0]  # 2 or 3 bytes of header, as its number says
            if len(self._buffer) < header:
                break
            length = int.from_bytes(self._buffer[1:header], "big")
            total = header + length + 3
            if length > MAX_PAYLOAD or length == 0:
                del self._buffer[0]
                continue
            if len(self._buffer) < total:
                break
            payload = self._checked(total, header)
            if payload is None:
                found.append(Rejected("vesc", "nonsense"))
                del self._buffer[0]
                continue
            del self._buffer[:total]
            values = values_of(payload)
            if values is not None:
                found.append(values)
        return found

    def _checked(self, total: int, header: int) -> bytes | None:
        whole = bytes(self._buffer[:total])
        payload, (crc, end) = whole[header:-3], struct.unpack(">HB", whole[-3:])
        return payload if end == END and crc == crc_hqx(payload, 0) else None


def values_of(payload: bytes) -> Values | None:
    """The values in an answer to COMM_GET_VALUES; None for another or a shorter one."""
    if payload[:1] != bytes((COMM_GET_VALUES,)) or len(payload) < MIN_VALUES:
        return None
    (erpm,) = struct.unpack_from(">i", payload, ERPM_AT)
    (tenth_v,) = struct.unpack_from(">h", payload, VOLTAGE_AT)
    return Values(erpm, tenth_v * 0.1, payload[FAULT_AT])
