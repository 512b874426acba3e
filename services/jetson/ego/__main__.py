"""The vehicle's own motion (speed, yaw rate, pose in the map) for whoever has to know whether it moves."""

from __future__ import annotations

from common.launch import service_app
from common.runtime import Service
from common.topics import EGO_MOTION
from services.jetson.ego.config import EgoConfig
from services.jetson.ego.pipeline import EgoPipeline
from services.jetson.ego.source import open_source


def run(config: EgoConfig) -> bool:
    pipeline, source = EgoPipeline(config), open_source(config)
    with Service("ego", config) as service:
        publish = service.publisher(EGO_MOTION)
        for stamp_ns, motion in source:
            publish(pipeline.process(stamp_ns, motion))
    return service.closed_cleanly


app = service_app("ego", EgoConfig, run, __doc__)


def main() -> None:
    app()


if __name__ == "__main__":
    main()
