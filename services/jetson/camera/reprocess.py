"""The camera's own results again, from its recorded pictures: for ``spotter replay --verify --service camera``."""

from __future__ import annotations

import threading
from collections.abc import Iterator

from common.bus.status import Report
from common.messages import CameraDetections
from services.jetson.camera.config import CameraConfig
from services.jetson.camera.pipeline import CameraPipeline
from services.jetson.camera.source import fitted, open_source


def reprocess(config: CameraConfig, report: Report) -> Iterator[CameraDetections]:
    """Every message that the service would publish on ``camera/detections``, without a bus."""
    config = fitted(config)
    pipeline = CameraPipeline(config)
    source, _ = open_source(config, report)
    for frame in source(threading.Event()):
        yield pipeline.process(frame.stamp_ns, frame.image, frame.motion)
