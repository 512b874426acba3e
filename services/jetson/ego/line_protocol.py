r"""A line of text for a microcontroller that knows how the vehicle moves. Pure.

    $SPOT,<seq>,<speed mm/s>,<yaw rate mrad/s>,<steering mrad>,<battery mV>*<CRC>\n

``seq`` counts 0 to 255 and begins again. A field that is not measured is empty. The CRC is CRC-16/CCITT-FALSE of
everything between ``$`` and ``*``, four hexadecimal digits. At least 10 lines a second, 115200 baud. For example
``$SPOT,17,1250,-35,,11800*8962``: 1.25 m/s, turning right by 0.035 rad/s, 11.8 V.
"""

from __future__ import annotations

from binascii import crc_hqx
from typing import NamedTuple

from services.jetson.ego.measurement import Measurement, Rejected

MAX_LINE = 80
FIELDS = 6


class Line(NamedTuple):
    """The numbers of one line; None = empty."""

    seq: int
    speed_mm_s: int | None = None
    yaw_mrad_s: int | None = None
    steering_mrad: int | None = None
    battery_mv: int | None = None


def line_of(line: Line) -> bytes:
    """The bytes that the microcontroller sends."""
    numbers = ("" if number is None else str(number) for number in line[1:])
    body = ",".join(("SPOT", str(line.seq % 256), *numbers)).encode("ascii")
    return b"$" + body + b"*%04X\n" % crc_hqx(body, 0xFFFF)


class LineReader:
    """Bytes as they come to measurements; repeated and broken lines are rejected by name."""

    def __init__(self) -> None:
        self._rest = b""
        self._seq: int | None = None

    def feed(self, at_s: float, data: bytes) -> list[Measurement | Rejected]:
        """What is complete now; ``at_s`` is the time of arrival."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        found = [self._read(at_s, line.rstrip(b"\r")) for line in lines if line.strip()]
        if len(self._rest) > MAX_LINE:
            self._rest = b""
            found.append(Rejected("serial", "nonsense"))
        return found

    def _read(self, at_s: float, text: bytes) -> Measurement | Rejected:
        line = parse_line(text)
        if line is None:
            return Rejected("serial", "nonsense")
        if line.seq == self._seq:
            return Rejected("serial", "repeated")  # a sender whose buffer is stuck
        self._seq = line.seq
        return Measurement(
            at_s,
            "serial",
            speed_mps=_thousandth(line.speed_mm_s),
            yaw_rate_radps=_thousandth(line.yaw_mrad_s),
            steering_rad=_thousandth(line.steering_mrad),
            battery_v=_thousandth(line.battery_mv),
        )


def parse_line(text: bytes) -> Line | None:
    """The numbers of one line, or None when anything about it is wrong."""
    if len(text) > MAX_LINE or not text.startswith(b"$SPOT,") or text[-5:-4] != b"*":
        return None
    body = text[1:-5]
    try:
        crc, fields = int(text[-4:], 16), body.decode("ascii").split(",")
        numbers = [int(field) if field else None for field in fields[1:]]
    except ValueError:
        return None
    seq = numbers[0] if numbers else None
    if crc != crc_hqx(body, 0xFFFF) or len(fields) != FIELDS or seq is None or not 0 <= seq <= 255:
        return None
    return Line(seq, *numbers[1:])


def _thousandth(number: int | None) -> float | None:
    return None if number is None else number * 1e-3
