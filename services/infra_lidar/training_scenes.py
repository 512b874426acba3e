"""Labelled clusters from generated roadside scenes: the pipeline's own ground and cluster steps, the simulator's truth.

What the classifier will meet in service is what it is trained on: clusters with the pieces that ground removal and
clustering leave, merge or break. The label of a cluster is what most of its points belong to.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import msgspec
import numpy as np

from common.sim.lidar128 import Scan, scan
from common.sim.roadside import LENGTH_S, RoadsideKind, roadside
from common.sim.solids import KINDS
from services.infra_lidar.calibration_keeper import CalibrationKeeper
from services.infra_lidar.classes import CLASSES
from services.infra_lidar.clustering import Clustering, ClusterPoints
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.ground import Ground
from services.infra_lidar.training_clusters import LabelledClusters, collect

CLASS_OF_KIND = {"pedestrian": "pedestrian", "cyclist": "cyclist", "car": "car", "bus": "large_vehicle"} | {
    "truck": "large_vehicle"
}
_CLASS_INDEX = np.array([CLASSES.index(CLASS_OF_KIND.get(kind, "background")) for kind in KINDS])
PURE = 0.7  # share of the points that must agree before a cluster teaches anything
# Columns a turn and every how manieth ring: sensors differ, and a forest must not depend on one spacing of points.
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


def scene_frames(
    seed: int, objects: int, kind: RoadsideKind, times_s: Iterable[float], config: InfraLidarConfig,
    resolution: tuple[int, int] = FULL,
) -> Iterator[SceneFrame]:  # fmt: skip
    """Frames of one scene, calibrated on the first of them; ``resolution`` is columns a turn and ring step."""
    scenario = roadside(seed, objects, kind)
    keeper = CalibrationKeeper(config.calibration, None)
    of_all_points = msgspec.structs.replace(config.clustering, shape_points=0)  # a forest knows clusters as they are
    ground, clustering = Ground(config.ground), Clustering(of_all_points, config.ground.range_max_m)
    for t_s in times_s:
        view = _thinned(scan(scenario, t_s, resolution[0]), resolution[1])
        frame = ground.remove(view.xyz, keeper.update(view.xyz).T_level_sensor)
        found = clustering.cluster(frame)
        road_z_m = ground.road_height(found.box[:, 0], found.box[:, 1])
        yield SceneFrame(view, found, np.asarray(road_z_m), *_truth(view, found))


def _thinned(view: Scan, ring_step: int) -> Scan:
    keep = view.ring % ring_step == 0
    return view if ring_step == 1 else Scan(*(getattr(view, name)[keep] for name in Scan.__dataclass_fields__))


def _truth(view: Scan, found: ClusterPoints) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    labels, purity, actor = np.zeros(len(found), np.int64), np.zeros(len(found)), np.full(len(found), -1, np.int64)
    for k, rows in enumerate(np.split(found.members, found.member_offsets[1:-1])):
        owners, first, count = np.unique(view.actor_id[rows], return_index=True, return_counts=True)
        best = int(count.argmax())
        actor[k], purity[k] = owners[best], count[best] / len(rows)
        labels[k] = _CLASS_INDEX[view.kind[rows[first[best]]]] if owners[best] >= 0 else 0
    return labels, purity, actor


def scene_clusters(
    seeds: Iterable[int], config: InfraLidarConfig, objects: tuple[int, ...] = (40, 80, 160),
    kinds: tuple[RoadsideKind, ...] = ("open", "level", "facade", "trees"), frames: int = 4,
) -> LabelledClusters:  # fmt: skip
    """Clusters of one scene per seed, kinds and densities taking turns; the group of a cluster is its scene."""
    clusters: list[np.ndarray] = []
    ground: list[float] = []
    labels: list[int] = []
    groups: list[int] = []
    for n, seed in enumerate(seeds):
        times_s = np.linspace(0.5, LENGTH_S - 0.5, frames)
        setting = objects[n % len(objects)], kinds[n % len(kinds)], times_s, config
        for frame in scene_frames(seed, *setting, RESOLUTIONS[(n // len(kinds)) % len(RESOLUTIONS)]):
            offsets = frame.clusters.offsets
            for k in np.flatnonzero(frame.purity >= PURE):
                clusters.append(frame.clusters.points[offsets[k] : offsets[k + 1]])
                ground.append(float(frame.road_z_m[k]))
                labels.append(int(frame.labels[k]))
                groups.append(seed)
    return collect(clusters, ground, labels, groups)
