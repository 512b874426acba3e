"""Spotter's verdict: SAFE, CAUTION or IMMINENT from lidar, radar and camera, and the health of every sensor."""

from __future__ import annotations

from common.launch import service_app
from common.runtime import Service
from common.topics import FUSION_HEALTH, FUSION_VERDICT
from services.jetson.fusion.config import FusionConfig
from services.jetson.fusion.pipeline import FusionPipeline
from services.jetson.fusion.source import observe


def run(config: FusionConfig) -> bool:
    pipeline = FusionPipeline(config)
    with Service("fusion", config) as service:
        publish_verdict = service.publisher(FUSION_VERDICT)
        publish_health = service.publisher(FUSION_HEALTH)
        for observation in observe(service, config):
            verdict, health = pipeline.process(observation)
            publish_verdict(verdict)
            if health is not None:
                publish_health(health)
                service.report.stages(pipeline.latency.summary())
    return service.closed_cleanly


app = service_app("fusion", FusionConfig, run, __doc__)


def main() -> None:
    app()


if __name__ == "__main__":
    main()
