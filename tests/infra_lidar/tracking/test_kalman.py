"""The Kalman filters against filterpy, one track at a time; the edge rule by table."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import settings as how
from hypothesis import strategies as st

from services.infra_lidar.tracking.config import TrackingConfig, kernel_settings
from services.infra_lidar.tracking.detections import DETECTION
from services.infra_lidar.tracking.kalman import TRACK, Innovation, correct, edge_shift, innovation, predict


def random_tracks(rng: np.random.Generator, count: int) -> np.ndarray:
    tracks = np.zeros(count, TRACK)
    tracks["mean"] = rng.normal(0, 5, (count, 6))
    tracks["size"] = rng.uniform(0.5, 5, (count, 3))
    tracks["yaw"] = rng.uniform(-3, 3, count)
    tracks["votes"] = rng.random((count, 5))
    for t in range(count):
        plane, height = rng.normal(0, 1, (4, 4)), rng.normal(0, 1, (2, 2))
        cov = np.zeros((6, 6))
        cov[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])] = plane @ plane.T + 0.1 * np.eye(4)
        cov[np.ix_([2, 5], [2, 5])] = height @ height.T + 0.1 * np.eye(2)
        tracks["cov"][t] = cov
    return tracks


def as_filterpy(track: np.void, dt_s: float, q: float) -> KalmanFilter:
    twin = KalmanFilter(dim_x=6, dim_z=3)
    twin.x, twin.P = track["mean"].copy()[:, None], track["cov"].copy()
    twin.F = np.eye(6) + dt_s * np.eye(6, k=3)
    block = q * q * np.array([[dt_s**3 / 3, dt_s**2 / 2], [dt_s**2 / 2, dt_s]])
    twin.Q = np.kron(block, np.eye(3))
    twin.H = np.eye(3, 6)
    return twin


def test_every_track_equals_its_filterpy_twin() -> None:
    rng = np.random.default_rng(1)
    tracks = random_tracks(rng, 40)
    twins = [as_filterpy(track, 0.13, 2.5) for track in tracks]
    settings = kernel_settings(TrackingConfig(acceleration_sigma=2.5))
    for _ in range(10):
        predict(tracks, 0.13, settings)
        for t, twin in enumerate(twins):
            twin.predict()
            plane, r_zz = rng.normal(0, 0.3, (2, 2)), 0.2
            noise = np.zeros((3, 3))
            noise[:2, :2], noise[2, 2] = plane @ plane.T + 0.05 * np.eye(2), r_zz
            z = rng.normal(0, 5, 3)
            e = z - tracks["mean"][t, :3]
            correct(tracks[t], Innovation(*e.tolist(), noise[0, 0], noise[0, 1], noise[1, 1], r_zz))
            twin.update(z[:, None], R=noise)
    for track, twin in zip(tracks, twins, strict=True):
        np.testing.assert_allclose(track["mean"], twin.x[:, 0], atol=1e-9)
        np.testing.assert_allclose(track["cov"], twin.P, atol=1e-9)


@how(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), first=st.floats(0.001, 1.0), second=st.floats(0.001, 1.0))
def test_two_steps_equal_one_of_the_same_time(seed: int, first: float, second: float) -> None:
    tracks = random_tracks(np.random.default_rng(seed), 3)
    once, settings = tracks.copy(), kernel_settings(TrackingConfig())
    predict(tracks, first, settings)
    predict(tracks, second, settings)
    predict(once, first + second, settings)
    np.testing.assert_allclose(tracks["mean"], once["mean"], atol=1e-9)
    np.testing.assert_allclose(tracks["cov"], once["cov"], atol=1e-9)


@pytest.mark.parametrize(
    ("case", "centre", "measured", "extent", "shift"),
    [
        ("whole and unmoved", 0.0, 4.0, 4.0, 0.0),
        ("whole and moved", 0.7, 4.0, 4.0, 0.7),
        ("far end hidden", -1.0, 2.0, 4.0, 0.0),
        ("near end hidden", 1.0, 2.0, 4.0, 0.0),
        ("middle part only", 0.3, 1.0, 4.0, 0.0),
        ("half hidden and moved on", 1.5, 2.0, 4.0, 0.5),
        ("half hidden and moved back", -1.5, 2.0, 4.0, -0.5),
        ("merged with a neighbour", 1.0, 6.0, 4.0, 0.0),
        ("merged and moved", 1.5, 6.0, 4.0, 0.5),
    ],
)
def test_an_interval_moves_only_as_far_as_its_edges_say(
    case: str, centre: float, measured: float, extent: float, shift: float
) -> None:
    got, doubt = edge_shift(centre, measured, extent)
    assert got == pytest.approx(shift), case
    assert doubt == pytest.approx((measured - extent) ** 2 / 12)


def one_pair(position: np.ndarray, size: np.ndarray, yaw: float, track_yaw: float) -> Innovation:
    """Of a detection, and a track of 4 x 2 m at the origin."""
    track, detection = np.zeros(1, TRACK), np.zeros(1, DETECTION)
    track["size"], track["yaw"] = (4.0, 2.0, 1.5), track_yaw
    detection["position"], detection["size"], detection["yaw"] = position, size, yaw
    return innovation(track[0], detection[0], kernel_settings(TrackingConfig(position_sigma_m=0.1)))


def test_the_edge_rule_works_along_the_tracks_own_axes() -> None:
    yaw = np.pi / 3
    along = np.array([np.cos(yaw), np.sin(yaw)])
    front_half_hidden = np.array([*(-1.0 * along), 0.0])
    e = one_pair(front_half_hidden, np.array([2.0, 2.0, 1.5]), yaw, yaw)
    np.testing.assert_allclose((e.x, e.y), 0.0, atol=1e-12)
    noise = np.array([[e.r_xx, e.r_xy], [e.r_xy, e.r_yy]])
    assert along @ noise @ along == pytest.approx(0.01 + 4 / 12)
    across = np.array([-along[1], along[0]])
    assert across @ noise @ across == pytest.approx(0.01)


@pytest.mark.parametrize("turn", [0.0, np.pi / 2, np.pi, -np.pi / 2])
def test_a_box_named_by_another_of_its_four_headings_is_the_same_box(turn: float) -> None:
    size = np.array([4.0, 2.0, 1.5]) if np.isclose(np.sin(turn), 0) else np.array([2.0, 4.0, 1.5])
    e = one_pair(np.array([0.5, 0.0, 0.0]), size, 0.2 + turn, 0.2)
    np.testing.assert_allclose((e.x, e.y), [0.5, 0.0], atol=1e-9)
