"""The frames between gate and microcontroller: layout, CRC, and the reader of the answers. Pure.

Permission, 12 bytes, gate to actuator:

    0      0xA5
    1      version, 1
    2      sequence number, one more with each frame, modulo 256
    3      0x00 STOP, 0x55 SLOW, 0xAA GO (four bits apart)
    4-5    speed limit, mm/s
    6-7    expiry, ms after arrival, at most 250: then the actuator stops by itself
    8-9    lower 16 bits of the verdict's sequence number, for logs
    10-11  CRC-16/CCITT-FALSE of bytes 0 to 9

Report, 10 bytes, actuator to gate, after each accepted frame, each change, and at least every 100 ms:

    0      0x5A
    1      version, 1
    2      sequence number of the last accepted frame
    3      what it does: 0x00, 0x55, 0xAA as above
    4      why: index into ``WHY``
    5      presses of the acknowledge button since power-up, modulo 256
    6      frames refused since power-up, modulo 256
    7      0
    8-9    CRC-16/CCITT-FALSE of bytes 0 to 7

Numbers are little-endian. 115200 baud, 8N1.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from typing import NamedTuple

from services.jetson.gate.pipeline import Decision, Permission

VERSION = 1
PERMISSION_SYNC, REPORT_SYNC = 0xA5, 0x5A
REPORT_BYTES = 10
CODES: dict[Permission, int] = {"STOP": 0x00, "SLOW": 0x55, "GO": 0xAA}
PERMISSIONS: dict[int, Permission] = {code: name for name, code in CODES.items()}
WHY = ("as told", "no frame yet", "frames stopped coming", "waiting for a second of steady frames")
FRAMES_STOPPED = WHY[2]
MAX_EXPIRY_MS = 250
MAX_MM_S = 0xFFFF


class Report(NamedTuple):
    """What the actuator says of itself."""

    seq: int
    permission: Permission
    why: str
    presses: int
    refused: int


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, initial value 0xFFFF; 0x29B1 of b"123456789"."""
    return crc_hqx(data, 0xFFFF)


def permission_frame(seq: int, decision: Decision, stop_valid_s: float, verdict_seq: int = 0) -> bytes:
    """The frame for a decision.

    Args:
        stop_valid_s: a STOP has no expiry of its own; the next frame is due within this.
    """
    valid_s = stop_valid_s if decision.permission == "STOP" else decision.valid_s
    body = struct.pack(
        "<BBBBHHH",
        PERMISSION_SYNC,
        VERSION,
        seq & 0xFF,
        CODES[decision.permission],
        min(int(decision.limit_mps * 1e3), MAX_MM_S),
        min(int(valid_s * 1e3), MAX_EXPIRY_MS),
        verdict_seq & 0xFFFF,
    )
    return body + struct.pack("<H", crc16(body))


class ReportReader:
    """Bytes as they come to reports; whatever is no report is counted and skipped."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.refused_bytes = 0

    def feed(self, data: bytes) -> list[Report]:
        """The reports that are complete now."""
        self._buffer += data
        found = []
        while len(self._buffer) >= REPORT_BYTES:
            report = _read_report(bytes(self._buffer[:REPORT_BYTES]))
            if report is None:
                self.refused_bytes += 1
            else:
                found.append(report)
            del self._buffer[: REPORT_BYTES if report else 1]
        return found


def _read_report(data: bytes) -> Report | None:
    sync, version, seq, code, why, presses, refused, _, crc = struct.unpack("<BBBBBBBBH", data)
    if sync != REPORT_SYNC or version != VERSION or crc != crc16(data[:-2]):
        return None
    if code not in PERMISSIONS or why >= len(WHY):
        return None
    return Report(seq, PERMISSIONS[code], WHY[why], presses, refused)
