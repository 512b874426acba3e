"""RoboSense Ruby (RS-128) and Ruby Plus packets to ranges. Bytes in, arrays out; no I/O.

Layout from the user manuals (RS-Ruby 1.0, RS-Ruby Plus), chapter 5: an MSOP packet of 1248 bytes has a header of 80,
three blocks of flag, return id, azimuth (0.01 degrees) and 128 times distance (5 mm) and reflectivity, big endian. Beam
angles are in the DIFOP packets that the sensor sends each second to another port. With two returns a block has the
azimuth of the one before it, also across packets: A A B, B C C. Read side by side with the vendor's rs_driver. Where
they disagree:

- Type of the sensor: bytes 31 and 32 (Plus manual) or 30 and 31 (rs_driver); both are tried, 5 and 1 are a Ruby Plus.
  The Ruby's manual has no such bytes: what is not a Plus is read as a Ruby, which differs in firing times and lens
  only.
- Firing times of the Ruby Plus: rs_driver has had two tables. Taken is the first, 32 groups of four; the second has a
  group of five and ends with the first's last value. They differ by at most 4 us, 0.015 degrees at 600 rpm.
- Time stamp: microseconds (manual, rs_driver) or nanoseconds (an older rs_driver) of the second; the number tells.
- The manual's example of a horizontal angle has the sign byte of a negative one and gives it as positive; negative is
  taken.

The sensor frame is rs_driver's: azimuth 0 is x, clockwise seen from above. The lens stands off the axis by ``LENS_M``.
"""

from __future__ import annotations

import json
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from services.infra_lidar.input.hesai_calibration import CalibrationError
from services.infra_lidar.input.range_image import RangeImage, RangeImageArrays
from services.infra_lidar.input.revolution import stack_packets
from services.infra_lidar.input.spinning import SensorFormat
from services.infra_lidar.input.velodyne import COS_SIN
from services.infra_lidar.jit import kernel

PACKET_BYTES, CHANNELS, BLOCKS = 1248, 128, 3
MSOP, DIFOP, DIFOP_TAIL = b"\x55\xaa\x05\x5a", b"\xa5\xff\x00\x5a\x11\x11\x55\x55", b"\x0f\xf0"
BLOCKS_AT = (80, 468, 856)
BLOCK_FLAG = 0xFE
VERTICAL_AT, HORIZONTAL_AT = 468, 852  # in a DIFOP packet, 3 bytes for each channel: sign, 0.01 degrees
BLOCK_US = 55.56
PERIOD_US, LONGEST_GAP_US = 64_000_000, 1_000_000
DUAL_STEP_US = BLOCK_US * BLOCKS / 2.0  # from one packet to the next, with two returns of each beam
SECOND_AT, FRACTION_AT = 14, 16  # 2 and 4 bytes
_PLUS_US = (
    0.0, 1.217, 2.434, 3.652, 4.869, 6.086, 7.304, 8.521, 9.739, 11.323, 12.907, 14.924, 16.941, 18.959, 20.976, 23.127,
    25.278, 27.428, 29.579, 31.963, 34.347, 36.498, 38.648, 40.666, 42.683, 44.267, 45.851, 47.435, 49.019, 50.603,
    52.187, 53.771,
)  # fmt: skip
FIRETIME_S = {  # four lasers at a time
    False: np.tile(np.repeat(np.arange(16) * 3.236e-6, 4), 2),
    True: np.repeat(_PLUS_US, 4) * 1e-6,
}
LENS_M = {False: 0.03615, True: 0.02892}


class RobosenseAngles(NamedTuple):
    """(128,) degrees of each channel."""

    vertical_deg: np.ndarray
    horizontal_deg: np.ndarray


def is_plus(packet: bytes) -> bool:
    """Whether an MSOP packet is a Ruby Plus's."""
    return packet[31:33] == b"\x05\x01" or packet[30:32] == b"\x05\x01"


def is_difop(packet: bytes) -> bool:
    """Whether a packet is a DIFOP packet, which holds the beam angles."""
    return len(packet) == PACKET_BYTES and packet[:8] == DIFOP and packet[1246:] == DIFOP_TAIL


def read_difop(packet: bytes) -> RobosenseAngles:
    """The beam angles in a DIFOP packet.

    Raises:
        CalibrationError: it is no such packet, or not of a calibrated Ruby.
    """
    if not is_difop(packet):
        raise CalibrationError("not a DIFOP packet of a RoboSense Ruby")

    def angles(at: int) -> np.ndarray:
        raw = np.frombuffer(packet, np.uint8, 3 * CHANNELS, at).reshape(CHANNELS, 3).astype(np.int64)
        return np.where(raw[:, 0] == 0, 1, -1) * (256 * raw[:, 1] + raw[:, 2]) / 100.0

    return checked(RobosenseAngles(angles(VERTICAL_AT), angles(HORIZONTAL_AT)))


def read_angle_file(text: str) -> RobosenseAngles:
    """The angles in a file as the vendor's tools write it: 128 lines of vertical and horizontal degrees.

    Raises:
        CalibrationError: it is no such file.
    """
    try:
        rows = [[float(cell) for cell in line.split(",")[:2]] for line in text.splitlines() if line.strip()]
        table = np.array(rows).reshape(-1, 2)
    except ValueError as error:
        raise CalibrationError(f"expected lines of vertical and horizontal degrees: {error}") from None
    if len(table) != CHANNELS:
        raise CalibrationError(f"expected a line for each of 128 channels, found {len(table)}")
    return checked(RobosenseAngles(table[:, 0], table[:, 1]))


def checked(angles: RobosenseAngles) -> RobosenseAngles:
    """The same angles.

    Raises:
        CalibrationError: they cannot be a Ruby's.
    """
    vertical, horizontal = angles
    if not (np.abs(vertical).max() <= 45.0 and np.abs(horizontal).max() <= 45.0):
        raise CalibrationError("expected angles within 45 degrees: the sensor is not calibrated, or it is no Ruby")
    if len(np.unique(vertical)) < CHANNELS // 2:
        raise CalibrationError("expected a different vertical angle for each channel: the sensor is not calibrated")
    return angles


def as_metadata(angles: RobosenseAngles) -> str:
    """Angles as a text, from which ``robosense_format`` makes the format."""
    return json.dumps({name: [round(value, 4) for value in array.tolist()] for name, array in angles._asdict().items()})


def unknown_angles() -> str:
    """Metadata to count the packets and returns of a sensor whose angles are not known; its points are nonsense."""
    return as_metadata(RobosenseAngles(np.arange(CHANNELS) / 10.0, np.zeros(CHANNELS)))


def is_msop(packet: bytes) -> bool:
    """Whether a packet is an MSOP packet of a Ruby, which holds ranges."""
    return len(packet) == PACKET_BYTES and not np.isnan(heads(stack_packets([packet]))[0, 0])


def is_dual(packet: bytes) -> bool:
    """Whether two returns of each beam are in it. For an MSOP packet."""
    return bool(heads(stack_packets([packet]))[0, 3] == DUAL_STEP_US)


@kernel
def heads(raw: np.ndarray) -> np.ndarray:
    """Where packets (P, B) uint8 lie, counted in microseconds of about a minute. See ``SensorFormat``.

    With two returns two of the three blocks have one azimuth.
    """
    rows = np.full((raw.shape[0], 4), np.nan)
    if raw.shape[1] != PACKET_BYTES:
        return rows
    azimuth = np.empty(BLOCKS, np.int64)
    for p in range(raw.shape[0]):
        is_msop = True
        for k in range(len(MSOP)):
            is_msop &= raw[p, k] == MSOP[k]
        for k in range(BLOCKS):
            at = BLOCKS_AT[k]
            azimuth[k] = 256 * raw[p, at + 2] + raw[p, at + 3]
            is_msop &= raw[p, at] == BLOCK_FLAG and azimuth[k] < 36000
        if is_msop:
            second = big_endian(raw[p, SECOND_AT : SECOND_AT + 2])
            fraction = big_endian(raw[p, FRACTION_AT : FRACTION_AT + 4])
            microsecond = fraction if fraction < 1_000_000 else fraction // 1000
            dual = azimuth[1] == azimuth[0] or azimuth[1] == azimuth[2]
            rows[p, 0], rows[p, 1] = azimuth[0] / 100.0, azimuth[2] / 100.0
            rows[p, 2] = second % 64 * 1_000_000 + microsecond % 1_000_000
            rows[p, 3] = DUAL_STEP_US if dual else BLOCK_US * BLOCKS
    return rows


@kernel
def big_endian(octets: np.ndarray) -> int:
    """The number that octets (n,) uint8 hold."""
    number = 0
    for octet in octets:
        number = 256 * number + octet
    return number


def robosense_format(metadata: str) -> SensorFormat:
    """The packet format of a sensor with the angles in ``metadata``, see ``as_metadata``.

    Raises:
        CalibrationError: they are not a Ruby's.
    """
    try:
        document = json.loads(metadata)
        columns = (np.array(document[name], float).reshape(CHANNELS) for name in RobosenseAngles._fields)
        angles = RobosenseAngles(*columns)
    except (ValueError, KeyError, TypeError) as error:
        raise CalibrationError(f"not the angles of a RoboSense Ruby: {error!r}") from None
    checked(angles)

    @lru_cache(maxsize=64)
    def beams(plus: bool, speed_deg_per_s: float) -> np.ndarray:
        return _beams(angles, plus, speed_deg_per_s)

    def decode(raw: np.ndarray) -> RangeImage:
        n = len(raw) * BLOCKS
        range_m, intensity = np.empty((n, CHANNELS), np.float32), np.empty((n, CHANNELS), np.uint8)
        cos, sin, bank = np.empty(n, np.float32), np.empty(n, np.float32), np.zeros(n, np.uint8)
        m = _decode(raw, COS_SIN, RangeImageArrays(range_m, intensity, cos, sin, bank, range_m))
        turning = beams(bool(n) and is_plus(raw[0, :40].tobytes()), _head_speed_deg_per_s(raw))
        return RangeImage(range_m[:m], intensity[:m], cos[:m], sin[:m], bank[:m], turning)

    return SensorFormat("robosense", heads, decode, PERIOD_US, LONGEST_GAP_US, metadata)


def _beams(angles: RobosenseAngles, plus: bool, speed_deg_per_s: float) -> np.ndarray:
    """(7, 128) float32, see ``RangeImage``."""
    fired = np.radians(speed_deg_per_s * FIRETIME_S[plus])  # turned since the block began
    turned, elevation = fired + np.radians(angles.horizontal_deg), np.radians(angles.vertical_deg)
    flat, lens_m = np.cos(elevation), LENS_M[plus]
    direction = [flat * np.cos(turned), -flat * np.sin(turned), np.sin(elevation)]  # turns clockwise from above
    origin = [lens_m * np.cos(fired), -lens_m * np.sin(fired), np.zeros(CHANNELS)]
    ring = np.argsort(np.argsort(angles.vertical_deg, kind="stable"))
    return np.stack([*direction, *origin, ring]).astype(np.float32)


@kernel
def _head_speed_deg_per_s(raw: np.ndarray) -> float:
    """Median speed of the head over packets (P, 1248) uint8, from the azimuths of their blocks."""
    steps = np.empty(raw.shape[0], np.float64)  # 0.01 degree
    for p in range(len(steps)):
        first, middle, last = [256 * raw[p, at + 2] + raw[p, at + 3] for at in BLOCKS_AT]
        steps[p] = (last - first) % 36000 / (1.0 if middle in (first, last) else 2.0)
    return np.median(steps) / (100.0 * BLOCK_US * 1e-6) if len(steps) else 0.0


@kernel
def _decode(raw: np.ndarray, cos_sin: np.ndarray, rows: RangeImageArrays) -> int:
    """Write packets (P, 1248) uint8 to rows, one for each valid block; returns the number of rows.

    A block with the azimuth of the one before is its second return; where that has the same range it is none.
    """
    m, previous = 0, -1
    for p in range(raw.shape[0]):
        for at in BLOCKS_AT:
            azimuth = 256 * raw[p, at + 2] + raw[p, at + 3]
            if raw[p, at] != BLOCK_FLAG or azimuth >= 36000:
                previous = -1
                continue
            second = azimuth == previous
            rows.cos[m], rows.sin[m] = cos_sin[azimuth, 0], -cos_sin[azimuth, 1]
            for k in range(128):
                byte = at + 4 + 3 * k
                range_m = np.float32(256 * raw[p, byte] + raw[p, byte + 1]) * np.float32(0.005)
                again = second and range_m == rows.range_m[m - 1, k]
                rows.range_m[m, k] = np.float32(0.0) if again else range_m
                rows.intensity[m, k] = raw[p, byte + 2]
            previous = -1 if second else azimuth
            m += 1
    return m
