"""Raw points of a fixed 128-beam lidar to tracked road users: calibrate, ground, cluster, classify, track."""

from __future__ import annotations

import numpy as np

from common.geometry import invert
from common.stopwatch import Stopwatch
from services.infra_lidar.background import BackgroundModel
from services.infra_lidar.blindness import BlindnessWatch, FrameQuality
from services.infra_lidar.buffers import Buffers
from services.infra_lidar.calibration import Calibration
from services.infra_lidar.calibration_keeper import CalibrationKeeper
from services.infra_lidar.classes import BACKGROUND
from services.infra_lidar.classifier import Classifier
from services.infra_lidar.clustering import Clustering, ClusterPoints
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.range_image import RangeImage, Returns
from services.infra_lidar.result import ClusterSet, FrameResult
from services.infra_lidar.scene import Parted, Scene
from services.infra_lidar.tracking import MultiObjectTracker, records_of
from services.infra_lidar.tracking_filter import DETECTION

_IDENTITY = np.eye(4)


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

        # 1. Where is the road? From the first frames; afterwards only looked after.
        calibration = self.calibration.update(returns)
        watch.lap("calibrate")

        # 2. Leave out what was always there, level the rest and take the road away. From here on in the level frame.
        parted = self.scene.part(stamp_ns, returns, calibration, quality is None or quality.complete)
        watch.lap("ground")

        # 3. Connected components of what is left, seen from above.
        found = self.clustering.cluster(parted.frame)
        watch.lap("cluster")

        # 4. What is it? Features and forest.
        clusters = self._classify(parted, found)
        watch.lap("classify")

        # 5. Who is it, and where does it go? In the map frame.
        T_map_level = self._map_from_level(calibration)
        self.tracker.step(stamp_ns, self._seen(clusters, found, T_map_level))
        tracks = self.tracker.told()
        watch.lap("track")

        # 6. Learn the fixed scene, as long as it is not known. Then: can the sensor see at all?
        if self.config.background.enabled and not parted.sifted:  # a sifted frame teaches nothing
            known = self.scene.learn(stamp_ns, returns, parted, _road_users(clusters, len(returns)))
            if known is not None:
                self.tracker.forget(_vanished(known, clusters))  # every other track keeps its id
        watch.lap("learn")
        total_ms = sum(watch.stage_ms.values())
        state, reason = self.blindness.judge(parted.seen, quality, total_ms, self.calibration.complaint)

        return FrameResult(
            stamp_ns=stamp_ns, received_ns=received_ns, frame_id=self.config.frame_id, state=state, reason=reason,
            returns=returns, parted=parted, clusters=clusters, table=tracks,
            calibration=calibration, T_map_level=T_map_level, stage_ms=watch.stage_ms,
        )  # fmt: skip

    def _classify(self, parted: Parted, found: ClusterPoints) -> ClusterSet:
        road_z_m = self.scene.ground.road_below(found.box)
        features, index, confidence, probabilities = self.classifier.recognise(
            found.planar, found.offsets, road_z_m, self._buffers, found.counts
        )
        self.scene.mark_structure(parted, found, road_z_m, index)
        return ClusterSet(
            classes=index, confidences=confidence, probabilities=probabilities, box=found.box,
            features=features, offsets=found.member_offsets, members=found.members, counts=found.counts,
            ground_z_m=road_z_m,
        )  # fmt: skip

    def _seen(self, clusters: ClusterSet, found: ClusterPoints, T_map_level: np.ndarray) -> np.ndarray:
        """All clusters for the tracker: background keeps tracks alive that the forest gave up for a moment."""
        box = found.box
        if self.config.tracking.boxes == "centroid":
            box = np.hstack((found.means, box[:, 3:]))
        return records_of(
            box, clusters.classes, clusters.confidences, clusters.counts, clusters.probabilities, T_map_level,
            self._buffers.take("seen", len(box), DETECTION),
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


def _road_users(clusters: ClusterSet, n: int) -> np.ndarray:
    """(N,) float32: how sure it is that a point is of a road user, 0 where its cluster is background or none."""
    sure, of_point = np.where(clusters.classes == BACKGROUND, 0.0, clusters.confidences), np.zeros(n, np.float32)
    of_point[clusters.members] = np.repeat(sure, clusters.counts)
    return of_point


def _vanished(known: np.ndarray, clusters: ClusterSet) -> np.ndarray:
    """(K,) bool: clusters of which more than a tenth is fixed scene, ``known`` (N,), and not seen any more."""
    of_cluster = np.repeat(np.arange(len(clusters)), clusters.counts)
    seen_no_more = np.bincount(of_cluster, known[clusters.members], minlength=len(clusters))
    return np.asarray(seen_no_more > 0.1 * clusters.counts)
