"""What numbers an Ouster's metadata may have. The bounds hold what every OS0, OS1, OS2 and OSDome says of itself."""

from __future__ import annotations

from typing import Any

import numpy as np

HIGHEST_DEG = 95.0  # a dome looks to the zenith, as it was built a little beyond
SMALLEST_SPREAD_DEG = 3.0  # those with the least have 15 degrees and more; 90 degrees in radians are 1.6
FARTHEST_ORIGIN_MM = 100.0
FARTHEST_SHIFT_MM = 1000.0
_LENGTH_SLACK = 1e-3  # of a rotation's rows


class MetadataError(ValueError):
    """The sensor's metadata lack what is needed; the text says what."""


def check_beams(altitude_deg: np.ndarray, azimuth_deg: np.ndarray, origin_mm: float) -> None:
    """Refuse angles and a distance that no sensor has.

    Raises:
        MetadataError: not finite, out of bounds, or altitudes that are nearly all the same.
    """
    _check_range("beam_altitude_angles", altitude_deg, -HIGHEST_DEG, HIGHEST_DEG, "degrees")
    _check_range("beam_azimuth_angles", azimuth_deg, -180.0, 180.0, "degrees")
    _check_range("lidar_origin_to_beam_origin_mm", np.array([origin_mm]), 0.0, FARTHEST_ORIGIN_MM, "mm")
    spread_deg = float(np.ptp(altitude_deg))
    if len(altitude_deg) > 1 and spread_deg < SMALLEST_SPREAD_DEG:
        raise MetadataError(
            f"beam_altitude_angles: from {altitude_deg.min():g} to {altitude_deg.max():g}: expected degrees that span "
            f"{SMALLEST_SPREAD_DEG:g} or more; are they radians?"
        )


def check_transform(to_sensor: np.ndarray) -> None:
    """Refuse a (4, 4) matrix that is not a rotation about z and a shift along it.

    Raises:
        MetadataError: another matrix, or a shift longer than a sensor.
    """
    name, rotation = "lidar_to_sensor_transform", to_sensor[:3, :3]
    shown = f"found {to_sensor.ravel().tolist()}"
    if not np.isfinite(to_sensor).all() or to_sensor[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        raise MetadataError(f"{name}: expected finite numbers, the last four 0 0 0 1; {shown}")
    off = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if off > _LENGTH_SLACK or np.linalg.det(rotation) < 0.0:
        raise MetadataError(f"{name}: expected a rotation, with rows of length 1 at right angles; {shown}")
    if np.abs([*to_sensor[2, :2], *to_sensor[:2, 3]]).max() > 1e-6:
        raise MetadataError(f"{name}: expected a rotation about z and a shift along it; {shown}")
    _check_range(f"{name}, its shift", to_sensor[:3, 3], -FARTHEST_SHIFT_MM, FARTHEST_SHIFT_MM, "mm")


def check_window(window: Any, columns: int) -> None:
    """Refuse a window whose columns a revolution does not have. The first may be the larger: it spans the seam then.

    Raises:
        MetadataError: not two of the ``columns`` of a revolution.
    """
    ends = window if isinstance(window, list) else []
    if len(ends) != 2 or not all(isinstance(end, int | float) and 0 <= end < columns for end in ends):
        raise MetadataError(f"column_window: expected two columns from 0 to {columns - 1}, found {window}")


def _check_range(name: str, values: np.ndarray, least: float, most: float, unit: str) -> None:
    wrong = values[~((values >= least) & (values <= most))]  # so that NaN is wrong too
    if len(wrong):
        raise MetadataError(f"{name}: expected {unit} from {least:g} to {most:g}, found {wrong[0]:g}")
