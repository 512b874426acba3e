"""The judge's generators: seeded, in the service's frame, and their geometry against closed forms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.infra_lidar.foreign import distance_fields, meshes, superquadrics
from benchmarks.infra_lidar.foreign.distances import Body
from benchmarks.infra_lidar.foreign.triangles import cast, extruded
from services.infra_lidar.classification.classes import CLASSES
from services.infra_lidar.training.clusters import LabelledClusters


@pytest.mark.parametrize("make", [superquadrics.clusters, distance_fields.clusters, meshes.clusters])
def test_a_seed_makes_the_same_clusters_of_every_class(make: Callable[[int, int], LabelledClusters]) -> None:
    size = 12 if make is distance_fields.clusters else 1
    one, again, other = make(1, size), make(1, size), make(2, size)
    np.testing.assert_array_equal(one.points, again.points)
    assert not np.array_equal(one.points, other.points)
    assert set(one.labels) == set(range(len(CLASSES)))
    assert np.all(np.diff(one.offsets) >= 20)
    assert np.all(np.isfinite(one.points))
    assert np.all(one.points[:, 2] > 0.0)  # the ground is taken away, its height is 0
    assert one.points[:, 2].max() < 7.0


def test_distances_of_a_capsule_a_box_and_a_ring() -> None:
    p = np.array([[0.0, 0.0, 2.0], [3.0, 0.0, 0.5]])
    np.testing.assert_allclose(Body(capsules=[(0, 0, 0, 0, 0, 1, 0.25)]).distance(p), [0.75, 2.75])
    np.testing.assert_allclose(Body(boxes=[(0, 0, 0, 1, 1, 1, 0.1)]).distance(p), [1.0, 2.0])
    np.testing.assert_allclose(Body(rings=[(0, 0, 0, 1.0, 0.1)]).distance(p), [0.9, np.hypot(3.0, 0.5) - 1.1])


def test_rays_meet_a_box_of_triangles_at_its_face() -> None:
    box = extruded([(-1.0, 0.0), (1.0, 0.0), (1.0, 2.0), (-1.0, 2.0)], 3.0)
    rays = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    np.testing.assert_allclose(cast(np.array([-6.0, 0.3, 0.9]), rays, box), [5.0, np.inf])
