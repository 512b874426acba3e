"""Raw points of a fixed 128-beam lidar to tracked road users: calibrate, ground, cluster, classify, track."""

from __future__ import annotations

import numpy as np

from common.geometry import invert, transform_points
from common.messages import ObjectTracks
from common.stopwatch import Stopwatch
from services.infra_lidar.background import BackgroundModel
from services.infra_lidar.blindness import BlindnessWatch, FrameQuality
from services.infra_lidar.buffers import Buffers
from services.infra_lidar.calibration import Calibration
from services.infra_lidar.calibration_keeper import CalibrationKeeper
from services.infra_lidar.classes import BACKGROUND, CLASSES, LABELS
from services.infra_lidar.classifier import Classifier
from services.infra_lidar.clustering import Clustering, ClusterPoints
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.result import ClusterSet, FrameResult
from services.infra_lidar.scene import Parted, Scene
from services.infra_lidar.tracking import Detections, MultiObjectTracker

SURE = 0.7  # a cluster of this confidence is kept out of the background


class InfraLidarPipeline:
    """One sensor's pipeline. Not for several threads at a time; make one per sensor.

    ``calibration``, ``background``: stored ones to begin with; without them the first frames decide.
    """

    def __init__(
        self,
        config: InfraLidarConfig,
        calibration: Calibration | None = None,
        background: BackgroundModel | None = None,
    ) -> None:
        self.config = config
        self._buffers = buffers = Buffers()
        self.calibration = CalibrationKeeper(config.calibration, calibration)
        self.scene = Scene(config, self.calibration, buffers, background)
        self.clustering = Clustering(config.clustering, config.ground.range_max_m, buffers)
        self.classifier = Classifier(config.classifier)
        self.tracker = MultiObjectTracker(config.tracking)
        self.blindness = BlindnessWatch(config.blindness)

    def recalibrate(self) -> None:
        """Forget calibration and background and begin again with the next frame."""
        self.calibration.restart()
        self.scene.restart()

    def process(
        self, stamp_ns: int, points: np.ndarray, quality: FrameQuality | None = None, received_ns: int = 0
    ) -> FrameResult:
        """One frame.

        stamp_ns: UTC nanoseconds of the measurement. points: (N, 3+) float32 metres in the sensor frame, further
        columns intensity and ring; points closer than half a metre or not finite are no returns. quality: what the
        source knows about losses.

        Raises:
            ValueError: points is not an (N, 3+) array of numbers.
        """
        points = _checked(points)
        watch = Stopwatch()

        # 1. Where is the road? From the first frames; afterwards only looked after.
        calibration = self.calibration.update(points)
        watch.lap("calibrate")

        # 2. Leave out what was always there, level the rest and take the road away. From here on in the level frame.
        parted = self.scene.part(stamp_ns, points, calibration, quality is None or quality.complete)
        watch.lap("ground")

        # 3. Connected components of what is left, seen from above.
        found = self.clustering.cluster(parted.frame)
        watch.lap("cluster")

        # 4. What is it? Features and forest.
        clusters = self._classify(parted, found)
        watch.lap("classify")

        # 5. Who is it, and where does it go? In the map frame.
        T_map_level = self._map_from_level(calibration)
        tracks = self.tracker.update(stamp_ns, self._detections(clusters, found, T_map_level))
        watch.lap("track")

        # 6. Learn the fixed scene, as long as it is not known. Then: can the sensor see at all?
        cluster_id = parted.spread(found.cluster_id)
        known = None
        if self.config.background.enabled and parted.source is None:  # a sifted frame teaches nothing
            known = self.scene.learn(stamp_ns, points, parted, _road_user(clusters, cluster_id))
        if known is not None:
            self.tracker.forget(_vanished(known, cluster_id, len(clusters)))  # every other track keeps its id
        watch.lap("learn")
        total_ms = sum(watch.stage_ms.values())
        state, reason = self.blindness.judge(parted.seen, quality, total_ms, self.calibration.complaint)

        message = ObjectTracks(
            stamp_ns=stamp_ns, frame_id=self.config.frame_id, received_ns=received_ns, state=state, reason=reason,
            stage_ms=watch.stage_ms, tracks=[track for track in tracks if track.label != CLASSES[BACKGROUND]],
            points_in=len(points), clusters=len(clusters),
        )  # fmt: skip
        return FrameResult(
            stamp_ns=stamp_ns, points=points, ground=parted.ground, cluster_id=cluster_id,
            background=parted.background, clusters=clusters, tracks=message, calibration=calibration,
            T_map_level=T_map_level, stage_ms=watch.stage_ms,
        )  # fmt: skip

    def _classify(self, parted: Parted, found: ClusterPoints) -> ClusterSet:
        road_z_m = self.scene.ground.road_height(found.box[:, 0], found.box[:, 1])
        features, index, confidence, probabilities = self.classifier.recognise(
            found.points, found.offsets, road_z_m, self._buffers
        )
        index[self.scene.structural(parted, found, road_z_m)] = BACKGROUND
        return ClusterSet(
            labels=[LABELS[i] for i in index], confidences=confidence, probabilities=probabilities,
            boxes=found.box[:, :7], features=features, counts=found.counts, ground_z_m=road_z_m,
        )  # fmt: skip

    def _detections(self, clusters: ClusterSet, found: ClusterPoints, T_map_level: np.ndarray) -> Detections:
        """All clusters in the map frame: background keeps tracks alive that the forest gave up for a moment."""
        turn = np.arctan2(T_map_level[1, 0], T_map_level[0, 0])
        boxes = clusters.boxes.astype(np.float64)
        centre = found.means if self.config.tracking.boxes == "centroid" else boxes[:, :3]
        return Detections(
            position_m=transform_points(T_map_level, centre), size_m=boxes[:, 3:6], yaw_rad=boxes[:, 6] + turn,
            labels=clusters.labels, confidence=clusters.confidences, points=clusters.counts,
            probabilities=clusters.probabilities,
        )  # fmt: skip

    def _map_from_level(self, calibration: Calibration) -> np.ndarray:
        """Identity without a surveyed pose: then the map is the road plane at the pole's foot."""
        if not self.config.T_map_sensor:
            return np.eye(4)
        return np.reshape(self.config.T_map_sensor, (4, 4)) @ invert(calibration.T_level_sensor)


def _checked(points: np.ndarray) -> np.ndarray:
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] < 3 or points.dtype.kind not in "fiu":
        raise ValueError(f"points: expected an (N, 3+) array of numbers, got {points.dtype} {points.shape}")
    return np.ascontiguousarray(points, dtype=np.float32)


def _road_user(clusters: ClusterSet, cluster_id: np.ndarray) -> np.ndarray:
    """(N,) bool: points of clusters that are road users for all we can tell."""
    sure = clusters.confidences >= SURE
    user = np.array([label != CLASSES[BACKGROUND] for label in clusters.labels], bool) & sure
    return np.asarray(np.append(user, False)[cluster_id])  # the last one is for id -1


def _vanished(known: np.ndarray, cluster_id: np.ndarray, count: int) -> np.ndarray:
    """(count,) bool: clusters of which more than a tenth is fixed scene, ``known`` (N,), and not seen any more."""
    total = np.bincount(cluster_id + 1, minlength=count + 1)[1:]
    return np.asarray(np.bincount(cluster_id[known] + 1, minlength=count + 1)[1:] > 0.1 * total)
