"""The recorder knows which places are never free, and how far a track has come."""

from types import SimpleNamespace

import numpy as np
import pytest

from services.infra_lidar.adaptation.recorder import SiteRecorder
from services.infra_lidar.result import ClusterSet
from services.infra_lidar.tracking.track_table import TrackTable

NAMES = ("z_top", "range_m")
HEDGE_M, CAR_M = np.array([10.0, 8.0, 0.5]), np.array([-20.0, 0.0, 0.5])


def _clusters(blobs):
    points = np.concatenate(blobs)
    counts = [len(blob) for blob in blobs]
    offsets = np.append(0, np.cumsum(counts)).astype(np.int32)
    k = len(blobs)
    box = np.zeros((k, 8), np.float32)
    box[:, :3] = [blob.mean(axis=0) for blob in blobs]
    found = ClusterSet(
        classes=np.zeros(k, np.int64), confidences=np.ones(k), probabilities=np.tile([0.2, 0.8, 0, 0, 0], (k, 1)),
        box=box, features=np.zeros((k, 1), np.float32), offsets=offsets,
        members=np.arange(len(points), dtype=np.int32), ground_z_m=np.zeros(k, np.float32),
    )  # fmt: skip
    return points, found


def _table(position_m):
    one = np.ones(1)
    return TrackTable(
        track_id=np.array([5]), label=np.array([1]), label_confidence=one, position_m=position_m[None],
        velocity_mps=np.array([[10.0, 0.0, 0.0]]), covariance=np.zeros((1, 6, 6)), size_m=np.ones((1, 3)),
        yaw_rad=np.zeros(1), age_s=one, score=one, state=np.array([1]), points=np.array([40]),
    )  # fmt: skip


@pytest.fixture
def record():
    """Ten seconds at 10 Hz: a hedge, and a car that drives past at 10 m/s."""
    recorder, rng = SiteRecorder(NAMES, 100.0), np.random.default_rng(3)
    for number in range(100):
        at = CAR_M + np.array([1.0 * number, 0.0, 0.0])
        blobs = [rng.uniform(-0.4, 0.4, (60, 3)) + HEDGE_M, rng.uniform(-0.4, 0.4, (40, 3)) + at]
        points, clusters = _clusters(blobs)
        result = SimpleNamespace(
            stamp_ns=number * 100_000_000, clusters=clusters, points=points, T_level_sensor=np.eye(4), table=_table(at)
        )
        recorder.add(result, {5: 1})
    return recorder.record()


def test_sampled_revolutions_are_half_a_second_apart_and_features_are_kept(record):
    assert np.diff(record.sampled_ns).min() >= 500_000_000
    assert len(record.sampled_ns) == 20
    assert record.x.shape == (40, 2)
    assert record.called.shape == (40, 5)
    np.testing.assert_allclose(record.x[0, 0], HEDGE_M[2] + 0.4, atol=0.1)


def test_the_hedge_stands_and_the_car_does_not(record):
    hedge = record.track == -1
    assert record.standing[hedge].min() > 0.7
    assert record.standing[~hedge].max() < 0.1


def test_the_history_of_the_track(record):
    history = record.tracks[5]
    assert history.moved_m == pytest.approx(99.0)
    assert history.frames == history.moving_frames == history.hits == 100
    np.testing.assert_allclose(history.votes, [20.0, 80.0, 0, 0, 0])


def test_nothing_seen_is_said():
    with pytest.raises(ValueError, match="no cluster"):
        SiteRecorder(NAMES, 100.0).record()
