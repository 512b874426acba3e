"""Radar on the Pi: raw chirps to tracks with levels, published as RadarTracks.

Sources: spi:0.0 (DreamHAT+), spi:emulator, file:RECORDING?rate=1&loop=1, mcap:RECORDING, sim:crossing?t0=0.
"""

from __future__ import annotations

import msgspec
import typer

from common.launch import service_app
from common.messages import EgoMotion
from common.raw import RawTap
from common.runtime import Service
from common.topics import EGO_MOTION, RADAR_DETECTIONS, RADAR_RAW, RADAR_TRACKS
from services.radar_pi.config import RadarConfig
from services.radar_pi.pipeline import RadarPipeline
from services.radar_pi.source import EgoSpeed, open_source, with_waveform_of_source
from services.radar_pi.tools import add_tools


def run(config: RadarConfig) -> bool:
    """Process frames and publish until the source ends."""
    config = with_waveform_of_source(config)
    pipeline = RadarPipeline(config)
    with Service("radar", config) as service:
        publish_tracks = service.publisher(RADAR_TRACKS)
        publish_detections = service.publisher(RADAR_DETECTIONS)
        ego = EgoSpeed(service.latest(EGO_MOTION, EgoMotion, "*"))
        raw = RawTap(service.publisher(RADAR_RAW), fitted={"waveform": msgspec.to_builtins(config.waveform)})
        for frame in open_source(config, service.report):
            speed_mps = frame.ego_mps if config.source.startswith("mcap:") else ego.now_mps()
            tracks = pipeline.process(frame.stamp_ns, frame.samples, speed_mps, frame.epoch, frame.note)
            tracks.received_ns = frame.received_ns
            publish_tracks(tracks)
            if publish_detections.wanted:
                publish_detections(pipeline.detections())
            raw(
                "bgt60", frame.stamp_ns, frame.samples, frame.received_ns, frame.epoch,
                note=frame.note, speed_mps=speed_mps,
            )  # fmt: skip
    return service.closed_cleanly


app: typer.Typer = service_app("radar", RadarConfig, run, __doc__)
add_tools(app)


def main() -> None:
    """The console command ``spotter-radar``."""
    app()


if __name__ == "__main__":
    main()
