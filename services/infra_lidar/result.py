"""The result of one frame: arrays, and the messages made from them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from common.geometry import transform_points
from common.messages import Cluster, Clusters, ObjectTracks, PointCloud
from services.infra_lidar.calibration.plane_fit import Calibration
from services.infra_lidar.classification.classes import BACKGROUND as BACKGROUND_CLASS
from services.infra_lidar.classification.classes import LABELS
from services.infra_lidar.clustering.boxes import of_points
from services.infra_lidar.input.range_image import Returns, count_of, points_of
from services.infra_lidar.segmentation.scene import Segmentation
from services.infra_lidar.tracking.track_table import TrackTable

OTHER, GROUND, CLUSTERED, BACKGROUND = np.uint8(0), np.uint8(1), np.uint8(2), np.uint8(3)


@dataclass(frozen=True)
class ClusterSet:
    """K clusters in the level frame.

    classes: (K,) int, index into ``LABELS``. confidences: (K,) of that class, probabilities: (K, C). box: (K, 8)
    float32: centre x, y, z, length, width, height (m), yaw (rad) and gap to the road (m). features: (K, F) float32.
    members (M,): index in the frame of the clustered points, grouped by cluster; cluster k is
    ``members[offsets[k]:offsets[k + 1]]`` with offsets (K + 1,). ground_z_m: (K,) height of the local road (m).
    """

    classes: np.ndarray
    confidences: np.ndarray
    probabilities: np.ndarray
    box: np.ndarray
    features: np.ndarray
    offsets: np.ndarray
    members: np.ndarray
    ground_z_m: np.ndarray

    def __len__(self) -> int:
        return len(self.classes)

    @property
    def counts(self) -> np.ndarray:
        """(K,) number of points."""
        return np.diff(self.offsets)

    @property
    def boxes(self) -> np.ndarray:
        """(K, 7): ``box`` without the gap."""
        return self.box[:, :7]

    @property
    def labels(self) -> list[str]:
        """K class names."""
        return [LABELS[i] for i in self.classes]


@dataclass(frozen=True)
class FrameResult:
    """Everything known about one frame of N returns, or N cells of a range image.

    segmentation: which of them are ground or background. table: all tracks, in the map frame. T_level_sensor,
    T_map_level: (4, 4) float64. Properties are computed when they are first read.
    """

    stamp_ns: int
    received_ns: int
    frame_id: str
    state: Literal["online", "degraded"]
    reason: str
    returns: Returns
    segmentation: Segmentation
    clusters: ClusterSet
    table: TrackTable
    calibration: Calibration
    T_map_level: np.ndarray
    stage_ms: dict[str, float]

    @property
    def points(self) -> np.ndarray:
        """(N, 3+) float32, sensor frame."""
        return points_of(self.returns)

    @property
    def ground(self) -> np.ndarray:
        """(N,) bool."""
        return self.segmentation.ground

    @property
    def background(self) -> np.ndarray:
        """(N,) bool: returns from the learned fixed scene."""
        return self.segmentation.background

    @cached_property
    def cluster_id(self) -> np.ndarray:
        """(N,) int32, index into ``clusters``, -1 = none."""
        return of_points(self.clusters.members, self.clusters.offsets, len(self.returns))

    @cached_property
    def tracks(self) -> ObjectTracks:
        """The message of all road users, in the map frame."""
        return ObjectTracks(
            stamp_ns=self.stamp_ns, frame_id=self.frame_id, received_ns=self.received_ns, state=self.state,
            reason=self.reason, stage_ms=self.stage_ms, tracks=self.table.without(BACKGROUND_CLASS).messages(),
            points_in=self.points_in, clusters=len(self.clusters),
        )  # fmt: skip

    @property
    def points_in(self) -> int:
        """Number of returns from the sensor."""
        return count_of(self.returns)

    @property
    def T_level_sensor(self) -> np.ndarray:
        """(4, 4) sensor frame to level frame, the calibration in use."""
        return self.calibration.T_level_sensor

    @property
    def T_map_sensor(self) -> np.ndarray:
        """(4, 4) sensor frame to map frame."""
        return np.asarray(self.T_map_level @ self.T_level_sensor)

    def clusters_message(self) -> Clusters:
        """All clusters, background included, in the map frame."""
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
            frame_id=self.frame_id,
            received_ns=self.received_ns,
            clusters=items[:5000],
        )

    def points_message(self, limit: int) -> PointCloud:
        """Every n-th return in the map frame, at most ``limit`` of them; rows of zeros or not finite are none."""
        xyz = self.points[:, :3]
        (thin,) = np.nonzero(xyz.any(axis=1) & np.isfinite(xyz).all(axis=1))
        thin = thin[:: max(1, -(-len(thin) // limit))]
        kind = np.where(self.background[thin], BACKGROUND, OTHER)
        kind[self.ground[thin]] = GROUND
        kind[self.cluster_id[thin] >= 0] = CLUSTERED
        points = self.points[thin]
        intensity = points[:, 3] if points.shape[1] > 3 else np.zeros(len(points))
        return PointCloud(
            stamp_ns=self.stamp_ns,
            frame_id=self.frame_id,
            received_ns=self.received_ns,
            points=transform_points(self.T_map_sensor, points[:, :3]).astype(np.float32),
            intensity=np.clip(intensity, 0, 255).astype(np.uint8),
            kind=kind,
        )
