"""Randomised bodies: seeded, of every class, of human and vehicle sizes, and hidden as they say."""

from __future__ import annotations

import numpy as np
import pytest

from services.infra_lidar.classification.classes import CLASSES
from services.infra_lidar.training.varied import generated_clusters, look_at
from services.infra_lidar.training.varied_furniture import furniture
from services.infra_lidar.training.varied_users import person, rider
from services.infra_lidar.training.varied_vehicles import car, large_vehicle
from spotter_sim.solids import Solids


def extent(shape: Solids) -> tuple[float, float]:
    """Length along x and height of the solids' own boxes, m."""
    half = np.abs(shape.from_unit).sum(axis=2)
    low, high = (shape.centre_m - half).min(axis=0), (shape.centre_m + half).max(axis=0)
    return float(high[0] - low[0]), float(high[2])


@pytest.mark.parametrize(
    ("make", "lengths_m", "heights_m"),
    [
        (person, (0.1, 2.6), (0.8, 2.6)),
        (rider, (0.9, 4.5), (1.0, 2.4)),
        (car, (2.2, 10.0), (1.1, 2.6)),
        (large_vehicle, (4.5, 20.0), (1.9, 4.5)),
        (furniture, (0.05, 24.0), (0.2, 8.0)),
    ],
)
def test_bodies_have_believable_sizes(make, lengths_m, heights_m) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(8)
    for _ in range(60):
        length, height = extent(make(rng))
        assert lengths_m[0] < length < lengths_m[1]
        assert heights_m[0] < height < heights_m[1]


def test_a_seed_makes_the_same_clusters_of_every_class() -> None:
    one, again = generated_clusters(3, 4, background=2), generated_clusters(3, 4, background=2)
    np.testing.assert_array_equal(one.points, again.points)
    np.testing.assert_array_equal(one.ground_z_m, again.ground_z_m)
    assert len(one) == 4 * (len(CLASSES) + 1)
    assert set(one.labels) == set(range(len(CLASSES)))
    assert np.all(np.isfinite(one.points))
    assert np.diff(one.offsets).min() >= 10


def test_a_vehicle_in_a_row_shows_less_of_itself() -> None:
    def mean_points(parked: bool) -> float:
        rng = np.random.default_rng(9)
        return float(np.mean([len(look_at(rng, car(rng), parked=parked)) for _ in range(60)]))

    assert mean_points(True) < 0.7 * mean_points(False)
