"""What one frame gives: arrays for notebooks and tests, and the messages made from them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from common.geometry import transform_points
from common.messages import Cluster, Clusters, ObjectTracks, PointCloud
from services.infra_lidar.calibration import Calibration

OTHER, GROUND, CLUSTERED, BACKGROUND = np.uint8(0), np.uint8(1), np.uint8(2), np.uint8(3)


@dataclass(frozen=True)
class ClusterSet:
    """K clusters in the level frame.

    labels: K class names. confidences: (K,) of that class, probabilities: (K, C). boxes: (K, 7) float32: centre x, y,
    z, length, width, height (m) and yaw (rad). features: (K, F) float32. counts: (K,) points. ground_z_m:
    (K,) height of the local road.
    """

    labels: list[str]
    confidences: np.ndarray
    probabilities: np.ndarray
    boxes: np.ndarray
    features: np.ndarray
    counts: np.ndarray
    ground_z_m: np.ndarray

    def __len__(self) -> int:
        return len(self.labels)


@dataclass(frozen=True)
class FrameResult:
    """Everything known about one frame of N points.

    ground: (N,) bool. cluster_id: (N,) int32, index into ``clusters``, -1 = none. background: (N,) bool, returns of the
    learned fixed scene. T_level_sensor, T_map_level: (4, 4) float64. tracks are in the map frame.
    """

    stamp_ns: int
    points: np.ndarray
    ground: np.ndarray
    cluster_id: np.ndarray
    background: np.ndarray
    clusters: ClusterSet
    tracks: ObjectTracks
    calibration: Calibration
    T_map_level: np.ndarray
    stage_ms: dict[str, float] = field(default_factory=dict)

    @property
    def T_level_sensor(self) -> np.ndarray:
        """(4, 4) the calibration in use."""
        return self.calibration.T_level_sensor

    @property
    def T_map_sensor(self) -> np.ndarray:
        """(4, 4) sensor frame to map frame."""
        return np.asarray(self.T_map_level @ self.T_level_sensor)

    def clusters_message(self) -> Clusters:
        """All clusters, background too, in the map frame."""
        clusters = self.clusters
        centres = transform_points(self.T_map_level, clusters.boxes[:, :3])
        turn = float(np.arctan2(self.T_map_level[1, 0], self.T_map_level[0, 0]))
        items = [
            Cluster(
                label=label,  # type: ignore[arg-type]
                confidence=float(confidence),
                centre_m=tuple(map(float, centre)),  # type: ignore[arg-type]
                size_m=tuple(map(float, box[3:6])),  # type: ignore[arg-type]
                yaw_rad=float(box[6]) + turn,
                points=int(count),
            )
            for label, confidence, centre, box, count in zip(
                clusters.labels, clusters.confidences, centres, clusters.boxes, clusters.counts, strict=True
            )
        ]
        return Clusters(
            stamp_ns=self.stamp_ns,
            frame_id=self.tracks.frame_id,
            received_ns=self.tracks.received_ns,
            clusters=items[:5000],
        )

    def points_message(self, limit: int) -> PointCloud:
        """Every n-th point in the map frame, so that at most ``limit`` remain."""
        step = max(1, -(-len(self.points) // limit))
        thin = slice(None, None, step)
        kind = np.where(self.background[thin], BACKGROUND, OTHER)
        kind[self.ground[thin]] = GROUND
        kind[self.cluster_id[thin] >= 0] = CLUSTERED
        points = self.points[thin]
        intensity = points[:, 3] if points.shape[1] > 3 else np.zeros(len(points))
        return PointCloud(
            stamp_ns=self.stamp_ns,
            frame_id=self.tracks.frame_id,
            received_ns=self.tracks.received_ns,
            points=transform_points(self.T_map_sensor, points[:, :3]).astype(np.float32),
            intensity=np.clip(intensity, 0, 255).astype(np.uint8),
            kind=kind,
        )
