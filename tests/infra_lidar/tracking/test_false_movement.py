"""Nothing moves where nothing moves: a hedge in pieces. (A standing recording, looped: test_pipeline.py.)"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from services.infra_lidar.config import TrackingConfig
from services.infra_lidar.tracking import Detections, MultiObjectTracker

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
