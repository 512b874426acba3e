"""Features by fixed heights and along the line of sight, against plain numpy and against cases known by hand."""

from __future__ import annotations

import numpy as np
import pytest

from services.infra_lidar.classification.band_kernels import BAND_NAMES, BANDS, EDGES_M
from services.infra_lidar.classification.features import compute_features


def row(points: np.ndarray, ground_z_m: float = 0.0) -> dict[str, float]:
    offsets, ground = np.array([0, len(points)]), np.array([ground_z_m])
    values = compute_features(points.astype(np.float32), offsets, ground, BAND_NAMES)[0]
    return dict(zip(BAND_NAMES, values.tolist(), strict=True))


def test_shares_and_extents_of_every_band_equal_their_plain_definition() -> None:
    rng = np.random.default_rng(3)
    along = rng.uniform(-0.5, 0.5, (500, 3)) * [4.0, 1.2, 3.4]
    got = row(along + np.array([20.0, 0.0, 1.9]), 0.1)
    height = along[:, 2] + 1.9 - 0.1
    values, vectors = np.linalg.eigh(np.cov(along[:, :2].T))
    places = along[:, :2] @ vectors[:, ::-1]
    for b, (low, high) in enumerate(zip((-np.inf, *EDGES_M[:-1]), EDGES_M, strict=True)):
        inside = (height >= low) & (height < high)
        assert got[f"band_frac_{b}"] == pytest.approx(inside.mean(), abs=1e-6)
        extent = np.ptp(places[inside], axis=0) if inside.sum() > 1 else (0.0, 0.0)
        assert (got[f"band_length_{b}"], got[f"band_width_{b}"]) == pytest.approx(tuple(extent), abs=1e-3)
    assert values[1] > values[0]


def test_hiding_the_legs_leaves_the_upper_bands_as_they_are() -> None:
    rng = np.random.default_rng(4)
    person = rng.uniform(-0.5, 0.5, (400, 3)) * [0.5, 0.3, 1.7] + [0.0, 15.0, 0.85]
    person = np.concatenate((person, [[-0.25, 15.0, 1.2], [0.25, 15.0, 1.2]]))
    whole, upper = row(person), row(person[person[:, 2] > 0.75])
    for b in range(3, BANDS):
        assert upper[f"band_length_{b}"] == pytest.approx(whole[f"band_length_{b}"], abs=0.08)
    assert upper["band_frac_0"] == 0.0


def test_leaves_scatter_along_the_beam_and_a_wall_does_not() -> None:
    rng = np.random.default_rng(5)
    y, z = rng.uniform(-1.0, 1.0, (2, 900))
    wall = row(np.column_stack((np.full(900, 12.0), y, z + 1.5)))
    leaves = row(np.column_stack((12.0 + rng.uniform(-0.5, 0.5, 900), y, z + 1.5)))
    assert wall["depth_scatter"] < 1e-3
    assert leaves["depth_scatter"] == pytest.approx(1.0 / np.sqrt(12.0), abs=0.04)
    assert leaves["depth_extent"] == pytest.approx(1.0, abs=0.01)
