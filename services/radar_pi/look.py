"""What the radar shows: frames a second from a chip with the right id, the noise floor, and the nearest track."""

from __future__ import annotations

from collections.abc import Iterator

from common.bus.look import Look, PeriodSamples, collect
from common.messages import RadarTracks
from services.radar_pi.chip.driver import RadarFrame
from services.radar_pi.chip.registers import CHIP_ID_BGT60TR13C
from services.radar_pi.config import RadarConfig
from services.radar_pi.pipeline import RadarPipeline
from services.radar_pi.source import open_source, with_waveform_of_source


def looks(config: RadarConfig, seconds: float) -> Iterator[Look]:
    """One ``Look`` a period, over the frames that came in it.

    Raises:
        ConfigError: the source cannot be opened as it is written.
    """
    config = with_waveform_of_source(config)
    pipeline = RadarPipeline(config)
    through_driver = config.source.startswith("spi:")
    for seen in collect(lambda report: open_source(config, report), seconds):
        tracks = [pipeline.process(f.stamp_ns, f.samples, None, f.epoch, f.note) for f in seen.items]
        yield describe(seen, tracks[-1], through_driver) if tracks else seen.nothing("frame")


def describe(seen: PeriodSamples[RadarFrame], newest: RadarTracks, through_driver: bool) -> Look:
    """The figures of one period. The driver sends frames only of a chip whose id it has read and compared."""
    chip = f"chip id 0x{CHIP_ID_BGT60TR13C:06x} (BGT60TR13C), " if through_driver else ""
    nearest = min((track.range_m for track in newest.tracks), default=None)
    track = "no track" if nearest is None else f"nearest track {nearest:.2f} m, {newest.level}"
    figures = f"{chip}{seen.rate_hz:.1f} frames a second, noise floor {newest.noise_floor_db:.1f} dB, {track}"
    if newest.state == "online" or newest.reason.startswith("settling"):
        return Look(sees=True, what=figures if newest.settled else f"{figures} (still learning what stands still)")
    return Look(sees=False, what=f"{figures}; {newest.reason}", do="see the reason; is metal close to the antenna?")
