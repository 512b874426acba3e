"""PointCloud and CompressedImage to sensor_msgs. Pure."""

from __future__ import annotations

from typing import Any

import numpy as np

from common import messages as m
from common.ros2.types import build, header
from spotter_tools.ros2.geometry import MAP

POINT_CLOUD2, COMPRESSED_IMAGE = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CompressedImage"
_RECORD = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("kind", "u1"), ("", "V3")])
_DATATYPE = {"<f4": 7, "|u1": 2}  # sensor_msgs/PointField


def point_cloud(message: m.PointCloud, host: str) -> Any:
    """x, y, z (m, map frame), intensity (0..255) and kind: 0 other, 1 ground, 2 in a cluster, 3 learned background."""
    rows = np.zeros(len(message.points), _RECORD)
    for k, axis in enumerate("xyz"):
        rows[axis] = np.asarray(message.points)[:, k]
    rows["intensity"], rows["kind"] = message.intensity, message.kind
    about: Any = _RECORD.fields
    fields = [
        build("sensor_msgs/msg/PointField", name=name, offset=about[name][1], datatype=_DATATYPE[about[name][0].str],
              count=1)
        for name in ("x", "y", "z", "intensity", "kind")
    ]  # fmt: skip
    return build(
        POINT_CLOUD2, header=header(message.stamp_ns, message.frame_id or MAP),
        height=1, width=len(rows), fields=fields,
        point_step=_RECORD.itemsize, row_step=rows.nbytes, data=np.frombuffer(rows.tobytes(), np.uint8), is_dense=True,
    )  # fmt: skip


def picture(message: m.CompressedImage, host: str) -> Any:
    """The JPEG with the boxes drawn in."""
    data = np.frombuffer(message.data, np.uint8)
    return build(COMPRESSED_IMAGE, header=header(message.stamp_ns, "camera"), format=message.format, data=data)
