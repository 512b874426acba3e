"""Camera: what is ahead, how far, and whether the camera can see.

Publishes CameraDetections for every picture it has time for, and the picture itself while somebody listens.
"""

from __future__ import annotations

from common.launch import service_app
from common.raw import RawTap, changes
from common.runtime import Service
from common.topics import CAMERA_DETECTIONS, CAMERA_IMAGE, CAMERA_RAW
from services.jetson.camera import calibrate
from services.jetson.camera.annotate import picture
from services.jetson.camera.config import CameraConfig
from services.jetson.camera.frames import NewestFrames, RateLimit
from services.jetson.camera.pipeline import CameraPipeline
from services.jetson.camera.source import fitted, open_source


def run(config: CameraConfig) -> bool:
    """Publish detections of each picture until the source or the process ends; False if not closed cleanly."""
    configured, config = config, fitted(config)
    pipeline = CameraPipeline(config)
    with Service("camera", config) as service:
        publish, publish_image = service.publisher(CAMERA_DETECTIONS), service.publisher(CAMERA_IMAGE)
        raw = RawTap(service.publisher(CAMERA_RAW), fitted=changes(configured, config))
        due = RateLimit(config.image.rate_hz)
        source, lossless = open_source(config, service.report)
        with NewestFrames(source, service.report, lossless) as frames:
            for frame in frames:
                seen = pipeline.process(frame.stamp_ns, frame.image)
                seen.received_ns = frame.received_ns
                publish(seen)
                if publish_image.wanted and due(frame.stamp_ns):
                    publish_image(picture(frame.image, seen, config.zone, config.image))
                raw("bgr8", frame.stamp_ns, frame.image, frame.received_ns)
    return service.closed_cleanly


app = service_app("camera", CameraConfig, run, __doc__)
app.add_typer(calibrate.app)


def main() -> None:
    """The console command ``spotter-camera``."""
    app()


if __name__ == "__main__":
    main()
