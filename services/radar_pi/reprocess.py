"""The radar's own results again, from a recording of its frames: for ``spotter replay --verify --service radar``."""

from __future__ import annotations

from collections.abc import Iterator

from common.bus.status import Report
from common.messages import RadarTracks
from services.radar_pi.config import RadarConfig
from services.radar_pi.pipeline import RadarPipeline
from services.radar_pi.source import open_source, with_waveform_of_source


def reprocess(config: RadarConfig, report: Report) -> Iterator[RadarTracks]:
    """Every message that the service would publish on ``radar/tracks``, without a bus."""
    config = with_waveform_of_source(config)
    pipeline = RadarPipeline(config)
    for frame in open_source(config, report):
        yield pipeline.process(frame.stamp_ns, frame.samples, frame.motion, frame.epoch, frame.note)
