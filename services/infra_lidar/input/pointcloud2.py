"""sensor_msgs/PointCloud2 to arrays. A message in, (N, 3..5) float32 out: x, y, z, intensity, ring; no I/O.

The message may be of any library: its attributes are read. Fields are taken by name, type and offset, as the message
tells them, and nothing is guessed: a cloud that contradicts itself is refused with what was found.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from services.infra_lidar.input.pcd import MAX_POINTS, FrameError, point_columns
from services.infra_lidar.input.plausible import in_metres, with_plausible_columns

DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # sensor_msgs/PointField
INTENSITY_NAMES = ("reflectivity", "intensity", "i")  # an Ouster's intensity is its raw signal: reflectivity first
RING_NAMES = ("ring", "channel", "line")  # Velodyne, Ouster, Hesai and RoboSense; Autoware; Livox
BRIGHTEST = 255.0  # intensities are 0..255 here


class PointField(Protocol):
    """sensor_msgs/PointField: where a value of a point lies among its bytes."""

    name: str
    offset: int
    datatype: int
    count: int


class PointCloud2(Protocol):
    """sensor_msgs/PointCloud2: ``height`` rows of ``width`` points. ``data`` is an array of bytes or bytes."""

    height: int
    width: int
    fields: Sequence[Any]  # of PointField
    is_bigendian: bool
    point_step: int
    row_step: int
    data: Any


def points_of_message(cloud: PointCloud2) -> np.ndarray:
    """(N, 3..5) float32 in the cloud's frame: x, y, z (m), intensity (0..255), ring; those that the cloud has.

    What is not finite is left out: that is how drivers tell "no return".

    Raises:
        FrameError: no coordinates, fields or sizes that contradict each other, no points, or not in metres.
    """
    fields = {field.name.lower(): field for field in cloud.fields}
    missing = [axis for axis in "xyz" if axis not in fields]
    if missing:
        raise FrameError(f"no field {' and '.join(missing)} among {' '.join(fields) or 'none'}")
    for axis in "xyz":
        if DATATYPES.get(fields[axis].datatype) not in ("f4", "f8"):
            raise FrameError(f"field {axis} is of type {_type_name(fields[axis])}: metres are expected as f4 or f8")
    intensity = next((fields[name] for name in INTENSITY_NAMES if name in fields), None)
    ring = next((fields[name] for name in RING_NAMES if name in fields), None)
    chosen = [*(fields[axis] for axis in "xyz"), *(field for field in (intensity, ring) if field is not None)]
    rows = _rows(cloud, chosen)
    brightness = None if intensity is None else np.clip(np.nan_to_num(rows[intensity.name]), 0, BRIGHTEST).ravel()
    rings = None if ring is None else rows[ring.name].ravel()
    xyz = [rows[field.name].ravel() for field in chosen[:3]]
    return with_plausible_columns(in_metres(point_columns(xyz, brightness, rings)))


def _rows(cloud: PointCloud2, chosen: Sequence[PointField]) -> np.ndarray:
    """(height, width) records of the chosen fields: a view of the cloud's bytes."""
    order = ">" if cloud.is_bigendian else "<"
    for field in chosen:
        if field.datatype not in DATATYPES or field.count not in (0, 1):  # 0: some drivers leave it out
            raise FrameError(f"field {field.name} is of type {_type_name(field)}: one number of types 1..8 is expected")
        if field.offset + np.dtype(DATATYPES[field.datatype]).itemsize > cloud.point_step:
            raise FrameError(
                f"field {field.name} at {field.offset} lies outside of a point, which has {cloud.point_step} bytes"
            )
    count = cloud.height * cloud.width
    if not 0 < count <= MAX_POINTS:
        raise FrameError(f"{count} points")
    if cloud.row_step < cloud.width * cloud.point_step and cloud.height > 1:
        raise FrameError(f"a row of {cloud.width} points of {cloud.point_step} bytes has {cloud.row_step} bytes")
    data = np.frombuffer(cloud.data, np.uint8)
    row_bytes = cloud.row_step if cloud.height > 1 else cloud.width * cloud.point_step
    needed = (cloud.height - 1) * row_bytes + cloud.width * cloud.point_step
    if len(data) < needed:
        raise FrameError(f"{count} points of {cloud.point_step} bytes are announced, {len(data)} bytes follow")
    record = np.dtype(
        {
            "names": [field.name for field in chosen],
            "formats": [order + DATATYPES[field.datatype] for field in chosen],
            "offsets": [field.offset for field in chosen],
            "itemsize": cloud.point_step,
        }
    )
    return np.ndarray((cloud.height, cloud.width), record, data, strides=(row_bytes, cloud.point_step))


def _type_name(field: PointField) -> str:
    kind = DATATYPES.get(field.datatype, f"datatype {field.datatype}")
    return kind if field.count in (0, 1) else f"{field.count} x {kind}"
