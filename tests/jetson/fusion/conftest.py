"""Builders of sensor messages and inputs that the fusion tests share."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from common.messages import (
    CameraDetection,
    CameraDetections,
    LidarZone,
    LidarZones,
    ObjectTracks,
    RadarTrack,
    RadarTracks,
)


def lidar(stamp_ns: int, level: Any = "SAFE", nearest_m: float | None = None, **more: Any) -> LidarZones:
    clear = LidarZone(nearest_m=None, points=0, level="SAFE")
    centre = LidarZone(nearest_m=nearest_m, points=9, level=level)
    return LidarZones(
        stamp_ns=stamp_ns, left=clear, centre=centre, right=clear, level=level, raw_level=level, **more
    )  # fmt: skip


def radar(stamp_ns: int, level: Any = "SAFE", **more: Any) -> RadarTracks:
    track = RadarTrack(
        track_id=7, range_m=1.0, azimuth_rad=0.1, velocity_mps=-0.8, age_frames=9, approaching=True, moving=True,
        ttc_s=1.25, level=level, snr_db=21.0,
    )  # fmt: skip
    defaults = {"settled": True, "noise_floor_db": -60.0, "tracks": [] if level == "SAFE" else [track]}
    return RadarTracks(stamp_ns=stamp_ns, level=level, **(defaults | more))


def camera(stamp_ns: int, level: Any = None, **more: Any) -> CameraDetections:
    box = CameraDetection(
        label="person", confidence=0.9, box_xyxy_px=(1, 2, 3, 4), distance_m=1.1, level=level or "SAFE",
        in_zone=True, truncated=False,
    )  # fmt: skip
    defaults = {"brightness": 100.0, "image_size_px": (640, 480), "detections": [] if level is None else [box]}
    return CameraDetections(stamp_ns=stamp_ns, level=level, **(defaults | more))


def infra(stamp_ns: int, **more: Any) -> ObjectTracks:
    return ObjectTracks(stamp_ns=stamp_ns, tracks=more.pop("tracks", []), **more)


@pytest.fixture(scope="session")
def messages() -> SimpleNamespace:
    """``messages.lidar(stamp_ns, level)`` and so on: valid messages with one object behind the level."""
    return SimpleNamespace(lidar=lidar, radar=radar, camera=camera, infra=infra)


@pytest.fixture(scope="session")
def build_message() -> dict[str, Callable[..., Any]]:
    """The same builders by sensor name."""
    return {"lidar": lidar, "radar": radar, "camera": camera, "infra_lidar": infra}
