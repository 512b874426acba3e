"""Radar on the Pi: raw chirps to tracks with levels, published as RadarTracks.

Sources: spi:0.0 (DreamHAT+), spi:emulator, file:RECORDING?rate=1&loop=1, mcap:RECORDING, sim:crossing?t0=0.
"""

from __future__ import annotations

import msgspec
import typer

from common.bus.ego import EgoWatch
from common.bus.look import add_look
from common.bus.raw_tap import RawTap
from common.bus.runtime import Service
from common.bus.service_app import run_app, service_app
from common.messages import EgoMotion
from common.topics import EGO_MOTION, RADAR_DETECTIONS, RADAR_MOTION, RADAR_RAW, RADAR_TRACKS
from services.radar_pi.config import RadarConfig
from services.radar_pi.look import looks
from services.radar_pi.pipeline import RadarPipeline
from services.radar_pi.source import open_source, with_waveform_of_source
from services.radar_pi.tools import add_tools


def run(config: RadarConfig) -> bool:
    """Process frames and publish until the source ends."""
    config = with_waveform_of_source(config)
    pipeline = RadarPipeline(config)
    with Service("radar", config) as service:
        publish_tracks = service.publisher(RADAR_TRACKS)
        publish_motion = service.publisher(RADAR_MOTION)
        publish_detections = service.publisher(RADAR_DETECTIONS)
        ego = EgoWatch(service.latest(EGO_MOTION, EgoMotion, config.ego_host), config.path)
        raw = RawTap(service.publisher(RADAR_RAW), fitted={"waveform": msgspec.to_builtins(config.waveform)})
        for frame in open_source(config, service.report):
            motion = frame.motion if config.source.startswith("mcap:") else ego.now()
            tracks = pipeline.process(frame.stamp_ns, frame.samples, motion, frame.epoch, frame.note)
            tracks.received_ns = frame.received_ns
            publish_tracks(tracks)
            if config.own_speed.enabled:
                publish_motion(pipeline.motion())
            if publish_detections.wanted:
                publish_detections(pipeline.detections())
            raw(
                "bgt60", frame.stamp_ns, frame.samples, frame.received_ns, frame.epoch,
                note=frame.note, motion=motion,
            )  # fmt: skip
    return service.closed_cleanly


app: typer.Typer = service_app("radar", RadarConfig, run, __doc__)
add_tools(app)
add_look(app, RadarConfig, looks)


def main() -> None:
    """The console command ``spotter-radar``."""
    run_app(app, "plot", "record")


if __name__ == "__main__":
    main()
