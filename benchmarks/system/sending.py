"""What it costs a sender to check every message with its readers' schema before it goes out.

    python -m benchmarks.system.sending

Encoding alone against encoding and decoding again, as ``common/bus/pubsub.py`` does it, for messages as large as in the
demo; and what share of one core the check takes at the topic's nominal rate.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from common import messages as m
from common import topics
from common.codec import encode, encode_for_readers

REPEAT_S = 0.4
ROUNDS = 5


def examples() -> dict[topics.Topic, m.Message]:
    """One message of each larger topic, sized as in the crossing."""
    dice = np.random.default_rng(0)
    now = {"stamp_ns": time.time_ns()}
    zone = m.LidarZone(nearest_m=0.61, points=9, level="CAUTION")
    beams, points = 450, 20_000
    radar = m.RadarTrack(
        track_id=1, range_m=4.2, azimuth_rad=0.1, velocity_mps=-1.5, age_frames=12, approaching=True, moving=True,
        ttc_s=2.8, level="CAUTION", snr_db=18.0,
    )  # fmt: skip
    road_user = m.ObjectTrack(
        track_id=7, label="car", label_confidence=0.9, position_m=(3.0, 4.0, 0.7), velocity_mps=(3.0, 4.0, 0.0),
        covariance=[[float(i == j) for j in range(6)] for i in range(6)], size_m=(4.0, 1.8, 1.5), yaw_rad=0.9,
        age_s=2.0, score=0.8, state="confirmed", points=120,
    )  # fmt: skip
    used = m.VerdictInput(state="online", level="CAUTION", age_ms=12.5, used=True, why="the nearest lane is near")
    return {
        topics.FUSION_VERDICT: m.Verdict(
            **now, level="CAUTION", rule="R1-worst-case", because="lidar sees something at 0.61 m",
            inputs=dict.fromkeys(("lidar", "radar", "camera", "infra_lidar"), used), confirmed=True, suppressed=False,
            advisory=None, blind=False, permission="SLOW",
        ),
        topics.RADAR_TRACKS: m.RadarTracks(
            **now, tracks=[radar] * 4, level="CAUTION", settled=True, noise_floor_db=-60.0
        ),
        topics.LIDAR_ZONES: m.LidarZones(
            **now, left=zone, centre=zone, right=zone, level="CAUTION", raw_level="CAUTION"
        ),
        topics.LIDAR_SCAN: m.LaserScan(
            **now, angles_rad=np.linspace(-3.1, 3.1, beams, dtype=np.float32),
            ranges_m=dice.uniform(0.2, 8.0, beams).astype(np.float32), confidence=np.full(beams, 200, np.uint8),
        ),
        topics.INFRA_TRACKS: m.ObjectTracks(**now, tracks=[road_user] * 15, points_in=90_000, clusters=20),
        topics.INFRA_POINTS: m.PointCloud(
            **now, points=dice.uniform(-50, 50, (points, 3)).astype(np.float32),
            intensity=np.zeros(points, np.uint8), kind=np.zeros(points, np.uint8),
        ),
        topics.CAMERA_IMAGE: m.CompressedImage(**now, format="jpeg", data=bytes(40_000)),
    }  # fmt: skip


def best_us(call: Callable[[], object]) -> float:
    """Microseconds a call, the best of several rounds."""
    best = float("inf")
    for _ in range(ROUNDS):
        count, begun_s = 0, time.perf_counter()
        while (spent_s := time.perf_counter() - begun_s) < REPEAT_S / ROUNDS:
            call()
            count += 1
        best = min(best, spent_s / count)
    return best * 1e6


def main() -> None:
    """The command above."""
    print(f"{'topic':<24}{'encode':>10}{'checked':>10}{'ratio':>8}{'of a core':>12}")
    whole = 0.0
    for topic, message in examples().items():
        plain_us = best_us(lambda message=message: encode(message))  # type: ignore[misc]
        checked_us = best_us(lambda message=message: encode_for_readers(message))  # type: ignore[misc]
        share = (checked_us - plain_us) * 1e-6 * topic.nominal_hz
        whole += share
        ratio = checked_us / plain_us
        print(f"{topic.name:<24}{plain_us:>7.1f} µs{checked_us:>7.1f} µs{ratio:>8.2f}{share:>12.3%}")
    print(f"{'all of them':<24}{'':>28}{whole:>12.3%}")


if __name__ == "__main__":
    main()
