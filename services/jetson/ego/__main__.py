"""The vehicle's own motion (speed, yaw rate, pose in the map) for whoever has to know whether it moves."""

from __future__ import annotations

from common.bus.look import add_look
from common.bus.runtime import Service
from common.bus.service_app import service_app
from common.topics import EGO_MOTION
from services.jetson.ego.config import EgoConfig
from services.jetson.ego.look import looks
from services.jetson.ego.pipeline import EgoPipeline
from services.jetson.ego.source import open_source


def run(config: EgoConfig) -> bool:
    """Publish the vehicle's motion until the source or the process ends; False if not closed cleanly."""
    open_source(config)  # a wrong source stops here, before a router is waited for
    pipeline = EgoPipeline(config)
    with Service("ego", config) as service:
        publish = service.publisher(EGO_MOTION)
        for stamp_ns, motion in open_source(config, service.report):
            publish(pipeline.process(stamp_ns, motion))
    return service.closed_cleanly


app = service_app("ego", EgoConfig, run, __doc__)
add_look(app, EgoConfig, looks)


def main() -> None:
    """The console command ``spotter-ego``."""
    app()


if __name__ == "__main__":
    main()
