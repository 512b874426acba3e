"""MSOP and DIFOP packets of RoboSense Ruby and Ruby Plus, written field by field from the user manuals, chapter 5.

Independent of the decoder; all fields are big endian. Points by the slow plain formulas of the vendor's rs_driver.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import numpy as np

VERTICAL_DEG = np.linspace(-25.0, 15.0, 128).round(2)
HORIZONTAL_DEG = np.tile([5.95, 2.48, -0.86, -5.95], 32)


def difop(vertical_deg: np.ndarray = VERTICAL_DEG, horizontal_deg: np.ndarray = HORIZONTAL_DEG) -> bytes:
    """A DIFOP packet with these angles (128,)."""

    def angles(values: np.ndarray) -> bytes:
        return b"".join(struct.pack(">BH", int(value < 0), round(float(abs(value)) * 100)) for value in values)

    packet = bytes.fromhex("a5ff005a11115555") + struct.pack(">H", 600)
    packet = packet.ljust(468, b"\0") + angles(vertical_deg) + angles(horizontal_deg) + bytes(10) + b"\x0f\xf0"
    assert len(packet) == 1248
    return packet


@dataclass(frozen=True)
class Msop:
    """One MSOP packet. azimuth: of its blocks in 0.01 degrees. steps, reflectivity: (3, 128)."""

    plus: bool = False
    azimuth: tuple[int, int, int] = (0, 20, 40)
    steps: np.ndarray = field(default_factory=lambda: np.full((3, 128), 2000))
    reflectivity: np.ndarray = field(default_factory=lambda: np.full((3, 128), 77))
    microsecond: int = 0
    dual: bool = False

    def build(self) -> bytes:
        """Its bytes."""
        head = b"\x55\xaa\x05\x5a\x01\x02\0" + bytes([3 if self.dual else 1]) + b"\x0b\xb8"
        seconds, microsecond = divmod(1_790_000_000_000_000 + self.microsecond, 1_000_000)
        head += seconds.to_bytes(6, "big") + struct.pack(">I", microsecond)
        head = head.ljust(31, b"\0") + (b"\x05\x01" if self.plus else b"\0\0")
        body = b""
        for block in range(3):
            body += struct.pack(">BBH", 0xFE, 1 + block % 2 if self.dual else 1, self.azimuth[block])
            for k in range(128):
                body += struct.pack(">HB", self.steps[block, k], self.reflectivity[block, k])
        return head.ljust(80, b"\0") + body + bytes(4)


def firing_us(plus: bool, channel: int) -> float:
    """Of rs_driver's tables, those that stand at this channel."""
    if not plus:
        return channel // 4 % 16 * 3.236
    return {0: 0.0, 4: 1.217, 31: 8.521, 64: 25.278, 100: 44.267, 127: 53.771}[channel]


def point_of(packet: Msop, block: int, channel: int, deg_per_s: float) -> np.ndarray:
    """(3,) m: slow and plain."""
    distance = packet.steps[block, channel] * 0.005
    fired = np.radians(packet.azimuth[block] / 100.0 + deg_per_s * firing_us(packet.plus, channel) * 1e-6)
    turned, up = fired + np.radians(HORIZONTAL_DEG[channel]), np.radians(VERTICAL_DEG[channel])
    lens = 0.02892 if packet.plus else 0.03615
    x = distance * np.cos(up) * np.cos(turned) + lens * np.cos(fired)
    y = -distance * np.cos(up) * np.sin(turned) - lens * np.sin(fired)
    return np.array([x, y, distance * np.sin(up)])
