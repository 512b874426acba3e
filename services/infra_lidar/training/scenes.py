"""Labelled clusters from generated roadside scenes: the pipeline's own ground and cluster steps, the simulator's truth.

The classifier is trained on what it gets in service: clusters with the errors of ground removal and clustering
(missing, merged or split parts). The label of a cluster is what most of its points belong to.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from services.infra_lidar.calibration.monitor import CalibrationMonitor
from services.infra_lidar.classification.classes import CLASSES
from services.infra_lidar.clustering.boxes import ClusterPoints
from services.infra_lidar.clustering.clustering import Clustering
from services.infra_lidar.config import CalibrationConfig, InfraLidarConfig
from services.infra_lidar.segmentation.ground import Ground
from services.infra_lidar.training.clusters import LabelledClusters, collect
from spotter_sim.lidar128 import Scan, scan
from spotter_sim.model import Scenario
from spotter_sim.roadside import LENGTH_S, RoadsideKind, roadside
from spotter_sim.solids import KINDS

CLASS_OF_KIND = {"pedestrian": "pedestrian", "cyclist": "cyclist", "car": "car", "bus": "large_vehicle"} | {
    "truck": "large_vehicle"
}
_CLASS_INDEX = np.array([CLASSES.index(CLASS_OF_KIND.get(kind, "background")) for kind in KINDS])
PURE = 0.7  # least share of points of one object; other clusters are not used for training
# Columns per revolution, and ring step: sensors differ, and a forest must not depend on one spacing of points.
FULL = (1800, 1)
RESOLUTIONS = (FULL, (1024, 1), FULL, (1800, 2))


@dataclass(frozen=True)
class SceneFrame:
    """One frame of a scene after the geometric steps, with the truth of every point."""

    scan: Scan
    clusters: ClusterPoints
    road_z_m: np.ndarray  # (K,)
    labels: np.ndarray  # (K,) majority class
    purity: np.ndarray  # (K,) share of the points that are of one and the same object
    actor: np.ndarray  # (K,) actor id of the majority, negative for the scene


@dataclass(frozen=True)
class Steps:
    """The geometric steps that make clusters of points; ``refine`` comes after them."""

    calibration: CalibrationConfig
    ground: Ground
    clustering: Clustering
    refine: Callable[[ClusterPoints], ClusterPoints] | None = None

    @classmethod
    def of(cls, config: InfraLidarConfig) -> Steps:
        """Those of the service."""
        clustering = Clustering(config.clustering, config.ground.range_max_m)
        return cls(config.calibration, Ground(config.ground), clustering)

    def clusters(self, points: np.ndarray, T_level_sensor: np.ndarray) -> ClusterPoints:
        """Clusters of (N, 3+) points, sensor frame."""
        found = self.clustering.cluster(self.ground.remove(points, T_level_sensor))
        return self.refine(found) if self.refine else found


def scene_frames(
    scenario: Scenario, times_s: Iterable[float], steps: Steps, resolution: tuple[int, int] = FULL
) -> Iterator[SceneFrame]:
    """Frames of one scene, calibrated on the first of them; ``resolution`` is columns a revolution and ring step."""
    monitor = CalibrationMonitor(steps.calibration, None)
    for t_s in times_s:
        view = scan(scenario, t_s, resolution[0])
        view = view if resolution[1] == 1 else select_returns(view, view.ring % resolution[1] == 0)
        yield segment_and_cluster(view, steps, monitor.update(view.xyz).T_level_sensor)


def select_returns(view: Scan, keep: np.ndarray) -> Scan:
    """The returns with ``keep`` (N,) bool."""
    return Scan(*(getattr(view, name)[keep] for name in Scan.__dataclass_fields__))


def segment_and_cluster(view: Scan, steps: Steps, T_level_sensor: np.ndarray) -> SceneFrame:
    """The geometric steps on one revolution, with its calibration."""
    found = steps.clusters(view.xyz, T_level_sensor)
    road_z_m = steps.ground.road_height(found.box[:, 0], found.box[:, 1])
    return SceneFrame(view, found, np.asarray(road_z_m), *_truth(view, found))


def _truth(view: Scan, found: ClusterPoints) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    number = len(found.box)
    labels, purity, actor = np.zeros(number, np.int64), np.zeros(number), np.full(number, -1, np.int64)
    for k, rows in enumerate(np.split(found.members, found.offsets[1:-1])):
        owners, first, count = np.unique(view.actor_id[rows], return_index=True, return_counts=True)
        best = int(count.argmax())
        actor[k], purity[k] = owners[best], count[best] / len(rows)
        labels[k] = _CLASS_INDEX[view.kind[rows[first[best]]]] if owners[best] >= 0 else 0
    return labels, purity, actor


def scene_clusters(
    seeds: Iterable[int], steps: Steps, objects: tuple[int, ...] = (40, 80, 160),
    kinds: tuple[RoadsideKind, ...] = ("open", "level", "facade", "trees"), frames: int = 4,
) -> LabelledClusters:  # fmt: skip
    """Clusters of one scene per seed, kinds and densities alternating; the group of a cluster is its scene."""

    def of_seeds() -> Iterator[tuple[int, SceneFrame]]:
        times_s = np.linspace(0.5, LENGTH_S - 0.5, frames)
        for n, seed in enumerate(seeds):
            scenario = roadside(seed, objects[n % len(objects)], kinds[n % len(kinds)])
            resolution = RESOLUTIONS[(n // len(kinds)) % len(RESOLUTIONS)]
            yield from ((seed, frame) for frame in scene_frames(scenario, times_s, steps, resolution))

    return pure_clusters(of_seeds())


def pure_clusters(frames: Iterable[tuple[int, SceneFrame]]) -> LabelledClusters:
    """The clusters of frames, each with its group, whose points mostly belong to one object."""
    clusters: list[np.ndarray] = []
    ground: list[float] = []
    labels: list[int] = []
    groups: list[int] = []
    for group, frame in frames:
        offsets = frame.clusters.offsets
        for k in np.flatnonzero(frame.purity >= PURE):
            clusters.append(frame.clusters.points[offsets[k] : offsets[k + 1], :3])
            ground.append(float(frame.road_z_m[k]))
            labels.append(int(frame.labels[k]))
            groups.append(group)
    return collect(clusters, ground, labels, groups)
