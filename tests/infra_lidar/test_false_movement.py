"""Nothing moves where nothing moves: a standing recording, looped."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.pipeline import InfraLidarPipeline

DATA = Path(os.environ.get("SPOTTER_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
STANDING = DATA / "lidar128-velodyne-vls128"


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
