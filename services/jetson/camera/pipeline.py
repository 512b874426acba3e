"""One picture -> what is ahead, how far, and whether the camera can see at all."""

from __future__ import annotations

import logging

import numpy as np

from common.messages import CameraDetection, CameraDetections, Level, Motion, worst
from common.path import Path, is_driving
from common.stopwatch import Stopwatch
from services.jetson.camera.config import CameraConfig, LensConfig
from services.jetson.camera.detector import Boxes, BoxFinder, Detector
from services.jetson.camera.distance import estimate, scaled, smallest
from services.jetson.camera.health import ViewMonitor, measure, reduce
from services.jetson.camera.parts import PartsMonitor
from services.jetson.camera.repeats import Repeats
from services.jetson.camera.upright import lens_of_upright
from services.jetson.camera.zone import band, cover_of, in_forward_zone, shifted, way_column_px

log = logging.getLogger(__name__)

MOST_NAMED = 10
NOT_FINITE = "the network's output holds numbers that are not finite: what is ahead is not known"


class CameraPipeline:
    """Give it picture after picture. It remembers the last picture, its boxes, and the counts of the health check."""

    def __init__(self, config: CameraConfig, detector: BoxFinder | None = None) -> None:
        """``detector`` takes the place of the network that the configuration names."""
        self._config = config
        self._detector: BoxFinder = detector or Detector(config.detector)
        self.unsized = [name for name in self._detector.names if config.distance.size_of(name) is None]
        if self.unsized:
            log.warning(
                "classes without a size in [distance.sizes]: %s; each is taken for a thing %.2f m high, the nearest it "
                "could be",
                ", ".join(self.unsized[:MOST_NAMED]) + (", ..." if len(self.unsized) > MOST_NAMED else ""),
                smallest(config.distance).height_m,
            )
        self._monitor = ViewMonitor(config.health)
        self._parts = PartsMonitor(config.health)
        self._repeats = Repeats()
        self._found = np.zeros((0, 4))  # boxes in the picture before, as shares of its width and height
        self._previous: np.ndarray | None = None

    def process(self, stamp_ns: int, image: np.ndarray, motion: Motion | None = None) -> CameraDetections:
        """Detections of one picture (H, W, 3) uint8 BGR taken at ``stamp_ns`` (UTC ns).

        ``motion`` is the vehicle's, None = unknown: the forward zone is the middle of the picture then.

        Raises:
            ValueError: the picture has another shape or type.
        """
        watch = Stopwatch()
        _check(image)

        # Is this picture a view at all?
        grey = reduce(image)
        measures = measure(grey, self._previous)
        view = self._monitor.update(stamp_ns, measures)
        parts = self._parts.update(stamp_ns, grey, self._previous, self._found, self._config.zone.width)
        self._previous = grey
        watch.lap("health")

        # What is in it (a blind camera sees nothing, whatever its network says)
        path = Path(self._config.path, motion) if is_driving(motion, self._config.path) else None
        lens = self._lens(image)
        found = [] if view.blind else self._detect(image, lens, path, watch)
        blind = view.reason or (NOT_FINITE if found is None else "")
        detections = found or []
        self._note_repeats(stamp_ns, detections, driving=path is not None)

        size = np.array([image.shape[1], image.shape[0]] * 2)
        self._found = np.array([one.box_xyxy_px for one in detections]).reshape(-1, 4) / size

        # The worst of what is ahead; None = nothing is ahead
        levels = [detection.level for detection in detections if detection.in_zone and detection.seen_before]
        level: Level | None = worst(*levels) if levels else None

        return CameraDetections(
            stamp_ns=stamp_ns,
            frame_id=self._config.frame_id,
            state="degraded" if view.degraded or blind or parts.reason else "online",
            reason=blind or parts.reason,
            stage_ms=watch.stage_ms,
            detections=detections,
            brightness=measures.brightness,
            level=level,
            image_size_px=(image.shape[1], image.shape[0]),
            provider=self._detector.provider,
            motion=motion,
            cover=cover_of(self._config, lens, blind or (parts.reason if parts.blind_ahead else "")),
            strips_see=(False,) * len(parts.sees) if view.blind else parts.sees,
        )

    def _note_repeats(self, stamp_ns: int, detections: list[CameraDetection], *, driving: bool) -> None:
        boxes = np.array([detection.box_xyxy_px for detection in detections]).reshape(-1, 4)
        for detection, seen in zip(detections, self._repeats.seen_before(stamp_ns, boxes), strict=True):
            detection.seen_before = bool(seen) or not driving

    def _lens(self, image: np.ndarray) -> LensConfig:
        """The configured lens for pictures of this size."""
        height_px, width_px = image.shape[:2]
        lens = lens_of_upright(self._config.lens, self._config.capture, width_px, height_px)
        return scaled(lens, width_px, height_px)

    def _detect(
        self, image: np.ndarray, lens: LensConfig, path: Path | None, watch: Stopwatch
    ) -> list[CameraDetection] | None:
        """None: the network has failed on this picture, and says nothing about it."""
        # Picture to network input: letterboxed, RGB, 0..1
        blob, fit = self._detector.preprocess(image)
        watch.lap("preprocess")

        # The network
        output = self._detector.infer(blob)
        watch.lap("inference")
        if not np.isfinite(output).all():
            return None

        # Its output to boxes in picture pixels, one per object
        boxes = self._detector.postprocess(output, fit, image.shape)
        watch.lap("postprocess")

        # How far, whether ahead, and in which band
        detections = self._locate(boxes, lens, path)
        watch.lap("distance")
        return detections

    def _locate(self, boxes: Boxes, lens: LensConfig, path: Path | None) -> list[CameraDetection]:
        config, detections = self._config, []
        for box, confidence, class_id in zip(*boxes, strict=True):
            label = self._detector.names[class_id]
            distance = estimate(box, label, lens, config.mount, config.distance)
            left, top, right, bottom = (float(value) for value in box)
            shift_px = way_column_px(distance.near_m, path, config.zone, lens) if path else 0.0
            detections.append(
                CameraDetection(
                    label=label,
                    confidence=float(confidence),
                    box_xyxy_px=(left, top, right, bottom),
                    distance_m=distance.distance_m,
                    distance_sigma_m=distance.sigma_m,
                    nearest_m=distance.near_m,
                    truncated=distance.truncated,
                    in_zone=in_forward_zone(shifted(box, shift_px), lens.width_px, config.zone),
                    level=band(distance.near_m, (bottom - top) / lens.height_px, config.zone),
                )
            )
        return detections


def _check(image: np.ndarray) -> None:
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or 0 in image.shape:
        raise ValueError(f"expected a picture (H, W, 3) uint8, got {image.shape} {image.dtype}")
