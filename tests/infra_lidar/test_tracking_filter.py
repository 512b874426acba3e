"""The stacked compiled filters against filterpy, one track at a time; the edge rule by table."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import settings as how
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from services.infra_lidar import tracking_assign, tracking_filter
from services.infra_lidar.jit import alone
from services.infra_lidar.tracking_assign import FORBIDDEN, cheapest
from services.infra_lidar.tracking_config import TrackingConfig
from services.infra_lidar.tracking_filter import DETECTION, TRACK, parameters

allowed_pairs, easy_pairs = alone(tracking_assign.allowed_pairs), alone(tracking_assign.easy_pairs)
chosen_pairs = alone(tracking_assign.chosen_pairs)
predict, correct = alone(tracking_filter.predict), alone(tracking_filter.correct)
edge_shift, innovation = alone(tracking_filter.edge_shift), alone(tracking_filter.innovation)


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
    settings, work = parameters(TrackingConfig(acceleration_sigma=2.5))[0], np.empty((6, 6))
    for _ in range(10):
        predict(tracks, 0.13, settings)
        for t, twin in enumerate(twins):
            twin.predict()
            plane, r_zz = rng.normal(0, 0.3, (2, 2)), 0.2
            noise = np.zeros((3, 3))
            noise[:2, :2], noise[2, 2] = plane @ plane.T + 0.05 * np.eye(2), r_zz
            z = rng.normal(0, 5, 3)
            e = z - tracks["mean"][t, :3]
            correct(tracks["mean"][t], tracks["cov"][t], e, noise[0, 0], noise[0, 1], noise[1, 1], r_zz, work)
            twin.update(z[:, None], R=noise)
    for track, twin in zip(tracks, twins, strict=True):
        np.testing.assert_allclose(track["mean"], twin.x[:, 0], atol=1e-9)
        np.testing.assert_allclose(track["cov"], twin.P, atol=1e-9)


@how(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), first=st.floats(0.001, 1.0), second=st.floats(0.001, 1.0))
def test_two_steps_equal_one_of_the_same_time(seed: int, first: float, second: float) -> None:
    tracks = random_tracks(np.random.default_rng(seed), 3)
    once, settings = tracks.copy(), parameters(TrackingConfig())[0]
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


def test_the_edge_rule_works_along_the_tracks_own_axes() -> None:
    mean, yaw, edges = np.zeros(6), np.pi / 3, parameters(TrackingConfig(position_sigma_m=0.1))[0]
    along = np.array([np.cos(yaw), np.sin(yaw)])
    hidden = np.array([*(-1.0 * along), 0.0])  # the front half of a 4 m car is hidden
    out = innovation(mean, np.array([4.0, 2.0, 1.5]), yaw, hidden, np.array([2.0, 2.0, 1.5]), yaw, edges)
    np.testing.assert_allclose(out[:2], 0.0, atol=1e-12)
    noise = np.array([[out[2], out[3]], [out[3], out[4]]])
    assert along @ noise @ along == pytest.approx(0.01 + 4 / 12)
    across = np.array([-along[1], along[0]])
    assert across @ noise @ across == pytest.approx(0.01)


@pytest.mark.parametrize("turn", [0.0, np.pi / 2, np.pi, -np.pi / 2])
def test_a_box_named_by_another_of_its_four_headings_is_the_same_box(turn: float) -> None:
    size = np.array([4.0, 2.0, 1.5]) if np.isclose(np.sin(turn), 0) else np.array([2.0, 4.0, 1.5])
    edges, known, there = parameters(TrackingConfig())[0], np.array([4.0, 2.0, 1.5]), np.array([0.5, 0, 0])
    out = innovation(np.zeros(6), known, 0.2, there, size, 0.2 + turn, edges)
    np.testing.assert_allclose(out[:2], [0.5, 0.0], atol=1e-9)


def test_pair_costs_equal_the_formula_written_out() -> None:
    rng = np.random.default_rng(2)
    tracks = random_tracks(rng, 6)
    seen = np.zeros(4, DETECTION)
    places = seen["position"] = tracks["mean"][:4, :3] + rng.normal(0, 0.4, (4, 3))
    chances = seen["chances"] = rng.dirichlet(np.ones(5), 4)
    rows, columns, costs = allowed_pairs(
        tracks, seen, parameters(TrackingConfig(boxes="full", position_sigma_m=0.2))[0]
    )
    got = np.full((6, 4), FORBIDDEN)
    got[rows, columns] = costs
    for t, track in enumerate(tracks):
        for d in range(4):
            S = track["cov"][:3, :3] + np.diag([0.04, 0.04, 0.09])
            e = places[d] - track["mean"][:3]
            d2 = e @ np.linalg.solve(S, e)
            same = track["votes"] @ chances[d] / track["votes"].sum()
            expected = d2 + np.log(np.linalg.det(S)) - np.log(same + 0.02) if d2 <= 7.81 else FORBIDDEN
            assert got[t, d] == pytest.approx(expected)


def assigned(cost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = np.nonzero(cost < FORBIDDEN)
    *pairs, costs = easy_pairs(rows, columns, cost[rows, columns], *cost.shape)
    return chosen_pairs(*pairs, costs, *cheapest(costs))


def test_more_pairs_than_there_was_room_for() -> None:
    rng = np.random.default_rng(5)
    tracks, seen = random_tracks(rng, 30), np.zeros(40, DETECTION)
    tracks["mean"][:], seen["chances"] = 0.0, 0.2
    tracks["cov"] = np.eye(6)
    rows, columns, costs = allowed_pairs(tracks, seen, parameters(TrackingConfig(boxes="full"))[0])
    assert len(rows) == len(columns) == len(costs) == 30 * 40
    assert len(set(zip(rows.tolist(), columns.tolist(), strict=True))) == 30 * 40
    assert len(set(np.round(costs, 9))) <= 30


def test_assignment_takes_the_cheapest_allowed_pairs() -> None:
    cost = np.array([[1.0, 2.0, FORBIDDEN], [1.5, FORBIDDEN, FORBIDDEN], [FORBIDDEN] * 3])
    rows, columns = assigned(cost)
    assert dict(zip(rows.tolist(), columns.tolist(), strict=True)) == {0: 1, 1: 0}
    assert len(assigned(np.empty((0, 5)))[0]) == 0


@how(max_examples=60, deadline=None)
@given(seed=st.integers(0, 100_000), n=st.integers(0, 9), k=st.integers(0, 9), share=st.floats(0.0, 1.0))
def test_leaving_out_the_easy_pairs_changes_nothing(seed: int, n: int, k: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    cost = np.where(rng.random((n, k)) < share, rng.normal(0, 3, (n, k)), FORBIDDEN)
    rows, columns = assigned(cost)
    r, c = linear_sum_assignment(cost)
    allowed = cost[r, c] < FORBIDDEN
    assert len(set(rows.tolist())) == len(rows) == allowed.sum()
    assert len(set(columns.tolist())) == len(columns)
    assert cost[rows, columns].sum() == pytest.approx(cost[r, c][allowed].sum())
