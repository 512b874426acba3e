"""From a Hesai's packets to tracks: a flat road with two vehicles, seen by an OT128 on a pole."""

from __future__ import annotations

import struct

import numpy as np
from msgspec.structs import replace

from services.infra_lidar.config import CalibrationConfig, InfraLidarConfig
from services.infra_lidar.input.hesai_calibration import as_metadata
from services.infra_lidar.input.hesai_parser import HesaiParser
from services.infra_lidar.pipeline import InfraLidarPipeline
from tests.infra_lidar.hesai_packets import ANGLES, ELEVATIONS_DEG, OFFSETS_DEG, OT128_FIRETIMES, Packet

HEIGHT_M = 4.0
BOXES = ((8.0, 3.0, 4.2, 1.8, 1.5), (4.0, -9.0, 10.0, 2.5, 3.0))  # x, y, length, width, height (m)
COLUMNS, TURNS, DEG_PER_S = 720, 12, 3600.0
LOOPS_US = np.array([[46.645, 34.067, 18.867, 6.289], [46.645, 34.067, 21.011, 6.289]])[:, np.arange(128) % 4]


def steps(azimuth_deg: float, state: int) -> np.ndarray:
    """(128,) ranges of a block in 4 mm, by ray casting in the directions in which the lasers really fire."""
    azimuth = np.radians(azimuth_deg + OFFSETS_DEG + LOOPS_US[state] * 1e-6 * DEG_PER_S)
    up = np.radians(ELEVATIONS_DEG)
    ray = np.stack([np.cos(up) * np.sin(azimuth), np.cos(up) * np.cos(azimuth), np.sin(up)], axis=-1)
    range_m = np.where(ray[:, 2] < -0.02, HEIGHT_M / np.maximum(-ray[:, 2], 0.02), 0.0)
    for x, y, length, width, height in BOXES:
        low = np.array([x - length / 2, y - width / 2, -HEIGHT_M])
        enter, leave = np.sort([low / ray, (low + np.array([length, width, height])) / ray], axis=0)
        enter_m, leave_m = enter.max(axis=-1), leave.min(axis=-1)
        hit = (enter_m > 0.0) & (enter_m < leave_m) & ((range_m == 0.0) | (enter_m < range_m))
        range_m = np.where(hit, enter_m, range_m)
    return np.round(range_m / 0.004).astype(int)


def turn() -> list[bytes]:
    """The packets of a turn."""
    packets = []
    for k in range(COLUMNS // 2):
        azimuth, states = (100 * k, 100 * k + 50), (k % 2, (k + 1) % 2)
        ranges = np.stack([steps(a / 100.0, state) for a, state in zip(azimuth, states, strict=True)])
        packets.append(Packet(azimuth=azimuth, states=states, steps=ranges, checks=False).build())
    return packets


def test_vehicles_in_a_street_are_tracked_where_they_stand() -> None:
    parser, packets = HesaiParser(as_metadata(ANGLES, OT128_FIRETIMES)), turn()
    config = replace(InfraLidarConfig(), calibration=CalibrationConfig(frames=1))
    pipeline, results = InfraLidarPipeline(config), []
    for number in range(TURNS * len(packets)):
        packet = packets[number % len(packets)]
        packet = packet[:-8] + struct.pack("<I", number) + packet[-4:]  # the sequence number before the check sum
        revolution = parser.feed(packet, number)
        if revolution is not None:
            assert revolution.quality.complete
            assert not revolution.quality.packets_lost
            results.append(pipeline.process((10 + len(results)) * 100_000_000, revolution.range_image))
    assert len(results) == TURNS - 1
    tracks = {track.label: track for track in results[-1].tracks.tracks if track.state == "confirmed"}
    for label, (x, y, length, _, _) in zip(("car", "large_vehicle"), BOXES, strict=True):
        assert np.hypot(tracks[label].position_m[0] - x, tracks[label].position_m[1] - y) < 0.5
        assert abs(tracks[label].size_m[0] - length) < 0.5
