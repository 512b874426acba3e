"""Raw points of a fixed 128-beam lidar to tracked road users: calibrate, ground, cluster, classify, track."""

from __future__ import annotations

import numpy as np

from common.geometry import invert
from common.stopwatch import Stopwatch
from services.infra_lidar.calibration.monitor import CalibrationMonitor
from services.infra_lidar.calibration.plane_fit import Calibration
from services.infra_lidar.classification.classes import BACKGROUND, LARGE_VEHICLE, UNKNOWN
from services.infra_lidar.classification.classifier import Classifier, reject_vehicles
from services.infra_lidar.clustering.boxes import ClusterPoints
from services.infra_lidar.clustering.clustering import Clustering
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.range_image import RangeImage, Returns
from services.infra_lidar.result import ClusterSet, FrameResult
from services.infra_lidar.segmentation.background import BackgroundModel
from services.infra_lidar.segmentation.scene import Scene, Segmentation
from services.infra_lidar.sensor_health import FrameQuality, VisibilityMonitor
from services.infra_lidar.tracking import MultiObjectTracker
from services.infra_lidar.tracking.detections import detection_records

_IDENTITY = np.eye(4)
PARKED_LARGE_CONFIDENCE = 0.95  # a large vehicle that stands while the background is learned is believed from here on


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
        self.calibration = CalibrationMonitor(config.calibration, calibration)
        self.scene = Scene(config, self.calibration, background)
        self.clustering = Clustering(config.clustering, config.ground.range_max_m)
        self.classifier = Classifier(config.classifier)
        self.tracker = MultiObjectTracker(config.tracking)
        self.visibility = VisibilityMonitor(config.visibility)

    def recalibrate(self) -> None:
        """Forget calibration, background and what the sensor usually sees; begin again with the next frame."""
        self.calibration.restart()
        self.scene.restart()
        self.visibility = VisibilityMonitor(self.config.visibility)

    def process(
        self, stamp_ns: int, returns: Returns, quality: FrameQuality | None = None, received_ns: int = 0
    ) -> FrameResult:
        """One frame.

        stamp_ns: UTC nanoseconds of the measurement. returns: a range image, or (N, 3+) float32 metres in the sensor
        frame, further columns intensity and ring; what is closer than half a metre or not finite is no return.
        quality: what the source knows about losses.

        Raises:
            ValueError: returns is no image and not an (N, 3+) array of numbers.
        """
        returns = _checked(returns)
        watch = Stopwatch()

        # 1. Calibrate: where is the road? From the first frames; afterwards it is only monitored.
        calibration = self.calibration.update(returns)
        watch.lap("calibrate")

        # 2. Segment: subtract the learned background, level the rest, remove the ground. From here in the level frame.
        complete = quality is None or quality.complete
        segmentation = self.scene.segment(stamp_ns, returns, calibration, complete)
        watch.lap("ground")

        # 3. Cluster: connected components of the obstacles, seen from above.
        found = self.clustering.cluster(segmentation.obstacles)
        watch.lap("cluster")

        # 4. Classify: features and forest.
        clusters = self._classify(segmentation, found)
        watch.lap("classify")

        # 5. Track, in the map frame. Background clusters too: they keep tracks alive that the forest gave up briefly.
        T_map_level = self._map_from_level(calibration)
        self.tracker.step(stamp_ns, self._detections(clusters, T_map_level))
        tracks = self.tracker.snapshot()
        watch.lap("track")

        # 6. Learn the background, as long as there is none.
        if self.config.background.enabled and not segmentation.background_subtracted:
            sure = _road_users(clusters, self.scene.on_drop(*clusters.box[:, :2].T))
            passing = _of_points(clusters, sure, len(returns))
            parked = _of_points(clusters, _parked(clusters, sure), len(returns))
            learned = self.scene.learn(stamp_ns, returns, segmentation, passing, parked)
            if learned is not None:
                self.tracker.forget(_vanished(learned, clusters))  # every other track keeps its id
        watch.lap("learn")

        # 7. Can the sensor see at all?
        total_ms = sum(watch.stage_ms.values())
        state, reason = self.visibility.update(segmentation.statistics, quality, total_ms, self.calibration.fault)

        return FrameResult(
            stamp_ns=stamp_ns, received_ns=received_ns, frame_id=self.config.frame_id, state=state, reason=reason,
            returns=returns, segmentation=segmentation, clusters=clusters, table=tracks,
            calibration=calibration, T_map_level=T_map_level, stage_ms=watch.stage_ms,
        )  # fmt: skip

    def _classify(self, segmentation: Segmentation, found: ClusterPoints) -> ClusterSet:
        road_z_m = self.scene.ground.road_height(found.box[:, 0], found.box[:, 1])
        called = self.classifier.extract_and_classify(found, road_z_m)
        on_drop = self.scene.on_drop(*found.box[:, :2].T)
        features, index, confidence, probabilities = reject_vehicles(called, on_drop)
        self.scene.mark_static(segmentation, found, index)
        return ClusterSet(
            classes=index, confidences=confidence, probabilities=probabilities, box=found.box,
            features=features, offsets=found.offsets, members=found.members, ground_z_m=road_z_m,
        )  # fmt: skip

    def _detections(self, clusters: ClusterSet, T_map_level: np.ndarray) -> np.ndarray:
        return detection_records(
            clusters.box, clusters.classes, clusters.confidences, clusters.counts, clusters.probabilities,
            T_map_source=T_map_level,
        )  # fmt: skip

    def _map_from_level(self, calibration: Calibration) -> np.ndarray:
        """Identity without a surveyed pose: then the map is the road plane at the pole's foot."""
        if not self.config.T_map_sensor:
            return _IDENTITY
        return np.reshape(self.config.T_map_sensor, (4, 4)) @ invert(calibration.T_level_sensor)


def _checked(returns: Returns) -> Returns:
    if isinstance(returns, RangeImage):
        return returns
    points = np.asarray(returns)
    if points.ndim != 2 or points.shape[1] < 3 or points.dtype.kind not in "fiu":
        raise ValueError(f"points: expected an (N, 3+) array of numbers, got {points.dtype} {points.shape}")
    return np.ascontiguousarray(points, dtype=np.float32)


def _road_users(clusters: ClusterSet, on_drop: np.ndarray) -> np.ndarray:
    """(K,) confidence that a cluster is a road user, 0 where it is background.

    Unknown counts as 0.5, and as 0 where ``on_drop`` (K,) says that there is no road below it.
    """
    sure = np.where(clusters.classes == UNKNOWN, np.where(on_drop, 0.0, 0.5), clusters.confidences)
    return np.where(clusters.classes == BACKGROUND, 0.0, sure)


def _parked(clusters: ClusterSet, sure: np.ndarray) -> np.ndarray:
    """(K,) the same for what stands there all the time: hedges and walls look like buses more often than buses park."""
    doubtful = (clusters.classes == LARGE_VEHICLE) & (sure < PARKED_LARGE_CONFIDENCE)
    return np.where(doubtful, 0.0, sure)


def _of_points(clusters: ClusterSet, value: np.ndarray, n: int) -> np.ndarray:
    """(N,) float32: the value (K,) of the cluster of each point, 0 where there is none."""
    of_point = np.zeros(n, np.float32)
    of_point[clusters.members] = np.repeat(value, clusters.counts)
    return of_point


def _vanished(learned: np.ndarray, clusters: ClusterSet) -> np.ndarray:
    """(K,) bool: clusters of which more than a tenth is background from now on, ``learned`` (N,) bool."""
    of_cluster = np.repeat(np.arange(len(clusters)), clusters.counts)
    seen_no_more = np.bincount(of_cluster, learned[clusters.members], minlength=len(clusters))
    return np.asarray(seen_no_more > 0.1 * clusters.counts)
