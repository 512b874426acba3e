"""Spotter's verdict: SAFE, CAUTION or IMMINENT from lidar, radar and camera, and the health of every sensor."""

from __future__ import annotations

from common.bus.runtime import Service
from common.bus.service_app import service_app
from common.topics import FUSION_HEALTH, FUSION_TRACE, FUSION_VERDICT
from services.jetson.fusion.config import FusionConfig
from services.jetson.fusion.journal import Journal
from services.jetson.fusion.pipeline import FusionPipeline
from services.jetson.fusion.source import observe
from services.jetson.fusion.store import Store
from services.jetson.fusion.trace import trace_of


def run(config: FusionConfig) -> bool:
    """Publish verdict and health until the process ends; False if not closed cleanly."""
    store, journal = Store(config.store, config.zenoh.namespace, config.host), Journal()
    pipeline = FusionPipeline(config, store.load())
    with Service("fusion", config) as service:
        publish_verdict = service.publisher(FUSION_VERDICT)
        publish_health = service.publisher(FUSION_HEALTH)
        publish_trace = service.publisher(FUSION_TRACE)
        for observation in observe(service, config):
            verdict, health = pipeline.process(observation)
            publish_verdict(verdict)
            journal.note_verdict(verdict)
            store.keep(pipeline.state(observation))
            if publish_trace.wanted and pipeline.step is not None:
                publish_trace(trace_of(pipeline.step, verdict, config.rules))
            if health is not None:
                publish_health(health)
                journal.note_health(health)
                service.report.stages(pipeline.latency.summary())
                for what, count in pipeline.take_new_bad_input().items():
                    service.report.bad_input(what, count)
    return service.closed_cleanly


app = service_app("fusion", FusionConfig, run, __doc__)


def main() -> None:
    """The console command ``spotter-fusion``."""
    app()


if __name__ == "__main__":
    main()
