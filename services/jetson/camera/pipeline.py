"""One picture -> what is ahead, how far, and whether the camera can see at all."""

from __future__ import annotations

import numpy as np

from common.messages import CameraDetection, CameraDetections, Level, worst
from common.stopwatch import Stopwatch
from services.jetson.camera.config import CameraConfig
from services.jetson.camera.detector import Boxes, Detector
from services.jetson.camera.distance import estimate, scaled
from services.jetson.camera.health import ViewMonitor, measure, reduce
from services.jetson.camera.zone import band, in_forward_zone


class CameraPipeline:
    """Give it picture after picture. It remembers the last picture and the counts of the health check, no more."""

    def __init__(self, config: CameraConfig) -> None:
        self._config = config
        self._detector = Detector(config.detector)
        self._monitor = ViewMonitor(config.health)
        self._previous: np.ndarray | None = None

    def process(self, stamp_ns: int, image: np.ndarray) -> CameraDetections:
        """Detections of one picture (H, W, 3) uint8 BGR taken at ``stamp_ns`` (UTC ns).

        Raises:
            ValueError: the picture has another shape or type.
        """
        watch = Stopwatch()
        _check(image)

        # Is this picture a view at all?
        grey = reduce(image)
        measures = measure(grey, self._previous)
        view = self._monitor.update(stamp_ns, measures)
        self._previous = grey
        watch.lap("health")

        # What is in it (a blind camera sees nothing, whatever its network says)
        detections = [] if view.blind else self._detect(image, watch)

        # The worst of what is ahead; None = nothing is ahead
        levels = [detection.level for detection in detections if detection.in_zone]
        level: Level | None = worst(*levels) if levels else None

        return CameraDetections(
            stamp_ns=stamp_ns,
            frame_id=self._config.frame_id,
            state="degraded" if view.degraded else "online",
            reason=view.reason,
            stage_ms=watch.stage_ms,
            detections=detections,
            brightness=measures.brightness,
            level=level,
            image_size_px=(image.shape[1], image.shape[0]),
            provider=self._detector.provider,
        )

    def _detect(self, image: np.ndarray, watch: Stopwatch) -> list[CameraDetection]:
        # Picture to network input: letterboxed, RGB, 0..1
        blob, fit = self._detector.preprocess(image)
        watch.lap("preprocess")

        # The network
        output = self._detector.infer(blob)
        watch.lap("inference")

        # Its output to boxes in picture pixels, one per object
        boxes = self._detector.postprocess(output, fit, image.shape)
        watch.lap("postprocess")

        # How far, whether ahead, and in which band
        detections = self._locate(boxes, image.shape[1], image.shape[0])
        watch.lap("distance")
        return detections

    def _locate(self, boxes: Boxes, width_px: int, height_px: int) -> list[CameraDetection]:
        config = self._config
        lens = scaled(config.lens, width_px, height_px)
        detections = []
        for box, confidence, class_id in zip(*boxes, strict=True):
            label = self._detector.names[class_id]
            distance = estimate(box, label, lens, config.mount, config.distance)
            left, top, right, bottom = (float(value) for value in box)
            detections.append(
                CameraDetection(
                    label=label,
                    confidence=float(confidence),
                    box_xyxy_px=(left, top, right, bottom),
                    distance_m=distance.distance_m,
                    distance_sigma_m=distance.sigma_m,
                    nearest_m=distance.near_m,
                    truncated=distance.truncated,
                    in_zone=in_forward_zone(box, width_px, config.zone),
                    level=band(distance.near_m, (bottom - top) / height_px, config.zone),
                )
            )
        return detections


def _check(image: np.ndarray) -> None:
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or 0 in image.shape:
        raise ValueError(f"expected a picture (H, W, 3) uint8, got {image.shape} {image.dtype}")
