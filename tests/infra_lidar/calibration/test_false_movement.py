"""Nothing moves where nothing moves: a hedge in pieces, and a standing recording, looped."""

from __future__ import annotations

import os
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from services.infra_lidar.config import InfraLidarConfig, TrackingConfig
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.tracking import Detections, MultiObjectTracker

DATA = Path(os.environ.get("SPOTTER_DATA", Path(__file__).resolve().parents[4] / "shared" / "data"))
STANDING = DATA / "lidar128-velodyne-vls128"


Piece = tuple[float, float, float, float, float, float]  # x, y, z, length, width, height


def _hedge(rng: np.random.Generator) -> list[Piece]:
    """20 m of hedge, as one piece, two or three."""
    edges, pieces = [36.0, *np.sort(rng.uniform(39.0, 53.0, rng.integers(0, 3))), 56.0], []
    for begin, end in pairwise(edges):
        low, high = begin + rng.uniform(0, 1.0), end - rng.uniform(0, 1.5)
        if high - low > 2:
            x, y, z = rng.uniform(-11.2, -11.0), (low + high) / 2, rng.uniform(2.8, 3.3)
            pieces.append((x, y, z, high - low, rng.uniform(0.8, 1.6), rng.uniform(1.1, 2.5)))
    return pieces


@pytest.mark.parametrize("seed", [17, 100])
def test_tracks_that_give_themselves_up_for_another_do_not_make_it_move(seed: int) -> None:
    """Taken for a large vehicle, the hedge falls apart elsewhere in every turn: its pieces' tracks are doubles."""
    rng = np.random.default_rng(seed)
    turns, odd, odd_at = [_hedge(rng) for _ in range(3)], _hedge(rng), rng.integers(0, 9)
    tracker, merged = MultiObjectTracker(TrackingConfig()), 0
    for k in range(30):
        box = np.array(odd if k == odd_at else turns[k % 3])
        seen = Detections(
            box[:, :3], box[:, 3:], np.full(len(box), np.pi / 2), ["large_vehicle"] * len(box),
            np.full(len(box), 0.9), np.round(12 * box[:, 3]).astype(int),
        )  # fmt: skip
        for track in tracker.update(1_790_000_000_000_000_000 + k * 100_000_000, seen):
            assert track.state == "tentative" or np.hypot(*track.velocity_mps[:2]) < 1.0, k
        merged += len(tracker.merged)
    assert merged > 0


@pytest.mark.slow
@pytest.mark.skipif(not STANDING.is_dir(), reason="no lidar128-velodyne-vls128 in SPOTTER_DATA")
def test_no_track_moves_on_the_standing_recording() -> None:
    """Three revolutions of a T-junction with hedges and fences, again and again: clusters change in every one."""
    frames = []
    for number in range(3):
        with np.load(STANDING / f"scan_{number}.npz") as z:
            frames.append(np.column_stack((z["xyz"], z["intensity"], z["ring"])).astype(np.float32))
    pipeline, confirmed = InfraLidarPipeline(InfraLidarConfig()), 0
    for number in range(36):
        result = pipeline.process(1_790_000_000_000_000_000 + number * 100_000_000, frames[number % 3])
        tracks = [track for track in result.tracks.tracks if track.state != "tentative"]
        confirmed += len(tracks)
        assert [track for track in tracks if np.hypot(*track.velocity_mps[:2]) > 1.0] == []
    assert confirmed > 100
