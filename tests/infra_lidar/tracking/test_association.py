"""Gate, cost and assignment against plain formulas and scipy on the whole matrix."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as how
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from services.infra_lidar.tracking.association import FORBIDDEN, NO_MATCH_COST, Pairs, assign, gated_pairs
from services.infra_lidar.tracking.config import TrackingConfig, kernel_settings
from services.infra_lidar.tracking.detections import DETECTION
from services.infra_lidar.tracking.kalman import TRACK


def tracks_at(rng: np.random.Generator, count: int) -> np.ndarray:
    tracks = np.zeros(count, TRACK)
    tracks["mean"], tracks["size"], tracks["votes"] = rng.normal(0, 5, (count, 6)), 1.0, rng.random((count, 5))
    root = rng.normal(0, 1, (count, 2, 2))
    tracks["cov"][:, :2, :2] = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(2)
    tracks["cov"][:, 2, 2] = rng.uniform(0.1, 2.0, count)
    return tracks


def test_pair_costs_equal_the_formula_written_out() -> None:
    rng = np.random.default_rng(2)
    tracks, seen = tracks_at(rng, 6), np.zeros(4, DETECTION)
    seen["position"] = tracks["mean"][:4, :3] + rng.normal(0, 0.4, (4, 3))
    seen["class_probabilities"] = rng.dirichlet(np.ones(5), 4)
    pairs = gated_pairs(tracks, seen, kernel_settings(TrackingConfig(boxes="full", position_sigma_m=0.2)))
    got = np.full((6, 4), FORBIDDEN)
    got[pairs.track, pairs.detection] = pairs.cost
    for t, track in enumerate(tracks):
        for d in range(4):
            S = track["cov"][:3, :3] + np.diag([0.04, 0.04, 0.09])
            e = seen["position"][d] - track["mean"][:3]
            d2 = e @ np.linalg.solve(S, e)
            same = track["votes"] @ seen["class_probabilities"][d] / track["votes"].sum()
            expected = d2 + np.log(np.linalg.det(S)) - np.log(same + 0.02) if d2 <= 7.81 else FORBIDDEN
            assert got[t, d] == pytest.approx(expected)


def test_all_pairs_may_be_within_the_gate() -> None:
    tracks, seen = tracks_at(np.random.default_rng(5), 30), np.zeros(40, DETECTION)
    tracks["mean"][:], seen["class_probabilities"] = 0.0, 0.2
    pairs = gated_pairs(tracks, seen, kernel_settings(TrackingConfig(boxes="full")))
    assert sorted(zip(*(column.tolist() for column in pairs[:2]), strict=True)) == [*np.ndindex(30, 40)]


def matches_of(cost: np.ndarray) -> dict[int, int]:
    track, detection = np.nonzero(cost < FORBIDDEN)
    matches = assign(Pairs(track, detection, cost[track, detection]))
    return dict(zip(matches.track.tolist(), matches.detection.tolist(), strict=True))


def test_assignment_takes_the_least_total_cost() -> None:
    no = FORBIDDEN
    assert matches_of(np.array([[1.0, 2.0, no], [1.5, no, no], [no, no, no]])) == {0: 1, 1: 0}
    assert matches_of(np.array([[1.0, 5.0], [2.0, 2.0]])) == {0: 0, 1: 1}
    assert matches_of(np.empty((0, 5))) == {}


def test_a_hidden_vehicle_does_not_take_the_detection_of_its_neighbour() -> None:
    """Track 0 sees its own car and a bush; track 1 has lost its car and could have that of track 0, if 0 took the
    bush."""
    seen, bush, lost = -8.0, -1.0, 4.0
    assert matches_of(np.array([[seen, bush], [lost, FORBIDDEN]])) == {0: 0}
    assert matches_of(np.array([[seen, seen + 0.5], [lost, FORBIDDEN]])) == {0: 1, 1: 0}
    dear = NO_MATCH_COST + 1.0
    assert matches_of(np.array([[seen, FORBIDDEN], [dear, dear]])) == {0: 0}, "contested and not worth it"
    assert matches_of(np.array([[dear]])) == {0: 0}, "nothing competes: the gate alone decides"


@how(max_examples=60, deadline=None)
@given(seed=st.integers(0, 100_000), n=st.integers(0, 9), k=st.integers(0, 9), share=st.floats(0.0, 1.0))
def test_the_total_cost_is_the_least_of_the_whole_matrix(seed: int, n: int, k: int, share: float) -> None:
    """Against scipy on a matrix in which each track has a column of its own for "no match"."""
    rng = np.random.default_rng(seed)
    cost = np.where(rng.random((n, k)) < share, rng.uniform(NO_MATCH_COST - 20.0, NO_MATCH_COST, (n, k)), FORBIDDEN)
    matches = matches_of(cost)
    whole = np.hstack((cost, np.full((n, n), NO_MATCH_COST)))
    least = whole[linear_sum_assignment(whole)].sum()
    assert len(set(matches.values())) == len(matches)
    assert sum(cost[pair] for pair in matches.items()) + NO_MATCH_COST * (n - len(matches)) == pytest.approx(least)
