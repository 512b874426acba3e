"""Where frames come from: the chip, a recording or the simulated world. The only file that opens a device or waits.

Every source yields ``RadarFrame``: UTC of the first chirp, UTC when the frame was complete, (rx, chirp, sample) ADC
samples, an epoch that rises when the chip was restarted, and what is wrong with the link.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import msgspec

from common.clock import monotonic_s, utc_at, utc_ns
from common.config import ConfigError
from common.messages import EgoMotion
from common.pubsub import Latest
from common.recording.raw import MCAP_PARAMETERS, fitted_as_recorded, replayed
from common.sim import bgt60
from common.sim.model import DeviceUnplugged
from common.sim.scenario_clock import ScenarioClock
from common.source_url import SourceUrl, parse_source
from common.status import Report
from common.topics import EGO_MOTION, RADAR_RAW
from services.radar_pi.config import RadarConfig, WaveformConfig
from services.radar_pi.driver import RadarFrame
from services.radar_pi.exports import plan
from services.radar_pi.parser import RecordingError
from services.radar_pi.recording import Recording, open_recording
from services.radar_pi.signals import simulator_waveform
from services.radar_pi.spi_source import open_spi

SCHEMES: dict[str, tuple[str, ...]] = {"sim": ("t0",), "file": ("rate", "loop"), "spi": (), "mcap": MCAP_PARAMETERS}

Frames = Iterator[RadarFrame]


def with_waveform_of_source(config: RadarConfig) -> RadarConfig:
    """The configuration with the waveform that its source really has: that of the recording, or the chip's.

    Raises:
        ConfigError: a wrong source, a missing or broken recording, a waveform that the chip cannot do.
    """
    url = parse_source(config.source, SCHEMES)
    if url.scheme == "file":
        return msgspec.structs.replace(config, waveform=_recording(url).waveform)
    if url.scheme == "mcap":
        return fitted_as_recorded(config, url, RADAR_RAW)
    if url.scheme == "spi":
        return msgspec.structs.replace(config, waveform=plan(config.waveform).waveform)
    return config


def open_source(config: RadarConfig, report: Report) -> Frames:
    """Frames of the configured source; ends when a recording ends.

    Raises:
        ConfigError: the source cannot be opened as it is written.
    """
    url = parse_source(config.source, SCHEMES)
    if url.scheme == "file":
        return _replay(_recording(url), url.number("rate", 1.0), loop=url.flag("loop"))
    if url.scheme == "spi":
        return open_spi(url.target, config, report)
    if url.scheme == "mcap":
        return _recorded_on_the_bus(url)
    return _simulate(ScenarioClock(url), config.waveform, report)


class EgoSpeed:
    """The vehicle's speed while it is fresh. ``latest`` is the subscription to EGO_MOTION."""

    def __init__(self, latest: Latest[EgoMotion]) -> None:
        self._latest = latest
        self._speed_mps: float | None = None
        self._arrived_s = 0.0

    def now_mps(self) -> float | None:
        """Forward speed; None = nobody tells, or what was told is too old."""
        for received in self._latest.take():
            self._speed_mps, self._arrived_s = received.message.speed_mps, received.arrived_s
        fresh = monotonic_s() - self._arrived_s <= (EGO_MOTION.age_limit_s or 0.0)
        return self._speed_mps if fresh else None


def _recording(url: SourceUrl) -> Recording:
    try:
        return open_recording(Path(url.target))
    except RecordingError as error:
        raise ConfigError(f"source {url}: {error}") from None


def _replay(recording: Recording, rate: float, *, loop: bool) -> Frames:
    """Recorded frames as if they came now, ``rate`` times as fast; rate 0 does not wait."""
    period_ns = round(recording.waveform.frame_period_s * 1e9)
    first_ns = int(recording.stamps_ns[0])
    length_ns = int(recording.stamps_ns[-1]) - first_ns + period_ns
    start_s, turn = monotonic_s(), 0
    while True:
        for stamp_ns, frame in recording:
            due_s = start_s + (stamp_ns - first_ns + turn * length_ns) * 1e-9 / (rate or 1.0)
            if rate > 0:
                time.sleep(max(0.0, due_s - monotonic_s()))
            yield RadarFrame(utc_at(due_s), utc_ns(), frame, epoch=turn, note="")
        if not loop:
            return
        turn += 1


def _recorded_on_the_bus(url: SourceUrl) -> Frames:
    """Raw frames of ``spotter record --raw radar``, each with the speed that the service had been told."""
    for piece in replayed(url, RADAR_RAW):
        note, speed_mps = str(piece.about.get("note", "")), piece.about.get("speed_mps")
        ego_mps = float(speed_mps) if isinstance(speed_mps, int | float) else None
        yield RadarFrame(piece.stamp_ns, piece.received_ns, piece.data, piece.epoch, note, ego_mps)


def _simulate(clock: ScenarioClock, waveform: WaveformConfig, report: Report) -> Frames:
    """The simulated world through the radar's eyes, at the waveform's frame rate; frames that came late are skipped."""
    sampled = simulator_waveform(waveform)
    start_s, number = monotonic_s(), 0
    while True:
        due_s = start_s + number * waveform.frame_period_s
        time.sleep(max(0.0, due_s - monotonic_s()))
        try:
            frame = bgt60.frame(clock.scenario, clock.at(due_s), sampled)
            yield RadarFrame(utc_at(due_s), utc_ns(), frame, epoch=0, note="")
        except DeviceUnplugged as error:
            report.state("disconnected", f"{error}: check the plug; trying again")
        except TimeoutError as error:
            report.state("disconnected", f"{error}: restarting the chip")
        behind = int((monotonic_s() - start_s) / waveform.frame_period_s) - number
        report.dropped(max(0, behind - 1))
        number += max(1, behind)
