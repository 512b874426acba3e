"""What a Hesai sensor's own calibration files say: beam angles and firing times. Text in, arrays out; no I/O.

Angles, "Angle Correction File" of all models: rows of channel, elevation, azimuth offset in degrees (user manuals,
"Channel distribution"). Firing times, "Firetime Correction File": how long after its block's start a channel fires. Its
rows differ:

- Pandar128E3X: channel, then far and near firing in ns for four azimuth states in High Resolution, two in Standard, two
  in Energy Saving mode. Taken is the far one: the near one is at most 2 us later, which turns the head by 0.01 degrees,
  and is of returns within 2.85 m: half a millimetre.
- OT128: channel, two azimuth states of Standard mode in us. Vendor's SDK 2.0 has this file counted from 0 and from 1;
  the lowest number tells. In High Resolution mode a channel fires in one half of that sequence of 55.556 us (manual
  B.4).
- QT128: channel and time in us, side by side for each firing sequence ("loop").
"""

from __future__ import annotations

import json
from typing import NamedTuple

import numpy as np

CHANNELS = 128
PANDAR128_PROTOCOL, QT128_PROTOCOL = (1, 4), (3, 2)  # versions of the UDP protocol
STATES = {PANDAR128_PROTOCOL: 8, QT128_PROTOCOL: 2}  # firing orders: four, two and two azimuth states; two loops
HALF_SEQUENCE_US = 27.778
MAX_FIRETIME_S = 200e-6


class CalibrationError(ValueError):
    """A calibration does not fit the sensor; the text says what was expected and what was found."""


class HesaiCalibration(NamedTuple):
    """elevation_deg, azimuth_deg: (128,) of each channel. firetime_s: (S, 128) by firing order, as ``STATES``.

    protocol: that the firing times belong to; None, and ``firetime_s`` is empty, where there are none.
    """

    elevation_deg: np.ndarray
    azimuth_deg: np.ndarray
    firetime_s: np.ndarray
    protocol: tuple[int, int] | None

    def firetimes_for(self, protocol: tuple[int, int]) -> np.ndarray:
        """(S, 128) seconds for packets of that protocol; zeros where there is no file."""
        return self.firetime_s if self.protocol == protocol else np.zeros((STATES[protocol], CHANNELS))


def as_metadata(angles: str, firetimes: str = "") -> str:
    """Both files as one text, from which ``read_metadata`` makes the calibration."""
    return json.dumps({"angles": angles, "firetimes": firetimes})


def with_firetimes(metadata: str, firetimes: str) -> str:
    """The text of ``as_metadata`` with other firing times."""
    return as_metadata(json.loads(metadata)["angles"], firetimes)


def unknown_angles() -> str:
    """Metadata to count the packets and returns of a sensor whose angles are not known; its points are nonsense."""
    return as_metadata("".join(f"{k + 1},{k / 10.0},0\n" for k in range(CHANNELS)))


def read_metadata(metadata: str) -> HesaiCalibration:
    """The calibration of the text of ``as_metadata``.

    Raises:
        CalibrationError: it is no such text, or not of this sensor.
    """
    try:
        document = json.loads(metadata)
        angles, firetimes = str(document["angles"]), str(document["firetimes"])
    except (ValueError, KeyError, TypeError) as error:
        raise CalibrationError(f"not the calibration of a Hesai sensor: {error!r}") from None
    return read_calibration(angles, firetimes)


def read_calibration(angles: str, firetimes: str = "") -> HesaiCalibration:
    """The calibration in the texts of both files; without firing times, channels count as fired at once.

    Raises:
        CalibrationError: a text is not of a sensor with 128 channels.
    """
    table = _channels(_rows(angles, 3), "angles")
    elevation_deg, azimuth_deg = table[:, 1], table[:, 2]
    if np.abs(elevation_deg).max() > 90.0 or np.abs(azimuth_deg).max() > 45.0:
        raise CalibrationError("angles: expected elevations within 90 and azimuth offsets within 45 degrees")
    if len(np.unique(elevation_deg)) < CHANNELS // 2:
        raise CalibrationError("angles: expected a different elevation for each channel")
    if not firetimes.strip():
        return HesaiCalibration(elevation_deg, azimuth_deg, np.zeros((0, CHANNELS)), None)
    return HesaiCalibration(elevation_deg, azimuth_deg, *read_firetimes(firetimes))


def read_firetimes(text: str) -> tuple[np.ndarray, tuple[int, int]]:
    """(S, 128) seconds after the start of the block, and the protocol that they belong to.

    Raises:
        CalibrationError: no firing times of a sensor with 128 channels.
    """
    times_s, protocol = _firetimes(text)
    if times_s.min() < 0.0 or times_s.max() > MAX_FIRETIME_S:
        raise CalibrationError("firing times: expected 0 to 200 us after the start of the block")
    return times_s, protocol


def _firetimes(text: str) -> tuple[np.ndarray, tuple[int, int]]:
    """(S, 128) seconds and the protocol that they belong to, told by the number of columns."""
    rows = _rows(text, 3)
    width = max((len(row) for row in rows), default=0)
    if width >= 17:
        table = _channels([row for row in rows if len(row) >= 17], "firing times")
        far_ns = np.where(table[:, 1:17:2] == -1.0, 0.0, table[:, 1:17:2])  # -1: does not fire
        return far_ns.T * 1e-9, PANDAR128_PROTOCOL
    if width == 3:
        loop_us = _channels(rows, "firing times")[:, 1:].T
        fine_us = loop_us[[0, 0, 1, 0]] % HALF_SEQUENCE_US  # azimuth states of the High Resolution mode
        return np.concatenate([fine_us, loop_us, loop_us]) * 1e-6, PANDAR128_PROTOCOL
    if width >= 4 and width % 2 == 0:
        return _by_loop(rows) * 1e-6, QT128_PROTOCOL
    raise CalibrationError(f"firing times: expected 3, 4 or 17 columns, found {width}")


def _by_loop(rows: list[list[float]]) -> np.ndarray:
    """(2, 128) us of each channel in both loops, from rows of channel and time side by side for each loop."""
    times_us, named = np.zeros((STATES[QT128_PROTOCOL], CHANNELS)), set()
    for row in rows:
        for loop in range(min(len(row) // 2, len(times_us))):
            if 1 <= row[2 * loop] <= CHANNELS:  # 0: nothing fires here
                channel = int(row[2 * loop]) - 1
                times_us[loop, channel] = row[2 * loop + 1]
                named.add(channel)
    if len(named) != CHANNELS:
        raise CalibrationError(f"firing times: expected a time for each of 128 channels, found {len(named)}")
    return times_us


def _rows(text: str, least: int) -> list[list[float]]:
    """Lines that begin with ``least`` numbers or more; titles and check sums are left out."""
    rows = []
    for line in text.splitlines():
        row = []
        for cell in line.strip().split(","):
            try:
                row.append(float(cell))
            except ValueError:
                break
        if len(row) >= least and np.isfinite(row).all():
            rows.append(row)
    return rows


def _channels(rows: list[list[float]], what: str) -> np.ndarray:
    """(128, K): one row for each channel, in their order."""
    ordered = sorted(rows)
    first = ordered[0][0] if ordered else 0.0
    numbers = [row[0] - first for row in ordered]
    if numbers != list(range(CHANNELS)) or first not in (0.0, 1.0):
        raise CalibrationError(f"{what}: expected a row for each of 128 channels, found {len(rows)}")
    return np.array([row[: min(map(len, ordered))] for row in ordered])
