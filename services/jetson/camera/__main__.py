"""Camera: what is ahead, how far, and whether the camera can see.

Publishes CameraDetections for every picture it has time for, and the picture itself while somebody listens.
"""

from __future__ import annotations

from common.bus.ego import EgoWatch
from common.bus.look import add_look
from common.bus.raw_tap import RawTap, changes
from common.bus.runtime import Service
from common.bus.service_app import service_app
from common.bus.status import Report
from common.messages import EgoMotion
from common.topics import CAMERA_DETECTIONS, CAMERA_IMAGE, CAMERA_RAW, EGO_MOTION
from services.jetson.camera.annotate import picture
from services.jetson.camera.config import CameraConfig
from services.jetson.camera.frames import NewestFrames, RateLimit
from services.jetson.camera.look import looks
from services.jetson.camera.pipeline import CameraPipeline
from services.jetson.camera.snap import snap
from services.jetson.camera.source import fitted, open_source
from services.jetson.camera.training import calibrate


def run(config: CameraConfig) -> bool:
    """Publish detections of each picture until the source or the process ends; False if not closed cleanly."""
    configured, config = config, fitted(config)
    pipeline = CameraPipeline(config)
    open_source(config, Report("camera"))  # a wrong source stops here, before a router is waited for
    with Service("camera", config) as service:
        publish, publish_image = service.publisher(CAMERA_DETECTIONS), service.publisher(CAMERA_IMAGE)
        service.report.count("classes without a size", len(pipeline.unsized))
        raw = RawTap(service.publisher(CAMERA_RAW), fitted=changes(configured, config))
        ego = EgoWatch(service.latest(EGO_MOTION, EgoMotion, config.ego_host), config.path)
        due = RateLimit(config.image.rate_hz)
        source, lossless = open_source(config, service.report)
        with NewestFrames(source, service.report, lossless) as frames:
            for frame in frames:
                motion = frame.motion if config.source.startswith("mcap:") else ego.now()
                seen = pipeline.process(frame.stamp_ns, frame.image, motion)
                seen.received_ns = frame.received_ns
                publish(seen)
                if publish_image.wanted and due(frame.stamp_ns):
                    publish_image(picture(frame.image, seen, config.zone, config.image))
                raw("bgr8", frame.stamp_ns, frame.image, frame.received_ns, motion=motion)
    return service.closed_cleanly


app = service_app("camera", CameraConfig, run, __doc__)
app.add_typer(calibrate.app)
app.command()(snap)
add_look(app, CameraConfig, looks)


def main() -> None:
    """The console command ``spotter-camera``."""
    app()


if __name__ == "__main__":
    main()
