"""Where frames come from: the chip, a recording or the simulated world.

Every source yields ``RadarFrame``: UTC of the first chirp, UTC when the frame was complete, (rx, chirp, sample) ADC
samples, an epoch that rises when the chip was restarted, and what is wrong with the link.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np

from common.bus.status import Report
from common.clock import monotonic_s, utc_at, utc_ns
from common.config import ConfigError
from common.pacing import ticks, wait_until
from common.recording.raw import MCAP_PARAMETERS, fitted_as_recorded, recorded_motion, replayed
from common.source_url import SourceUrl, parse_source
from common.topics import RADAR_RAW
from services.radar_pi.chip.driver import RadarFrame
from services.radar_pi.chip.exports import plan
from services.radar_pi.config import RadarConfig, WaveformConfig
from services.radar_pi.emulator.signals import simulator_waveform
from services.radar_pi.parser import RecordingError
from services.radar_pi.recording import Recording, open_recording
from services.radar_pi.spi_source import open_spi
from spotter_sim import bgt60
from spotter_sim.model import DeviceUnplugged
from spotter_sim.scenario_clock import ScenarioClock

SCHEMES: dict[str, tuple[str, ...]] = {"sim": ("t0",), "file": ("rate", "loop"), "spi": (), "mcap": MCAP_PARAMETERS}

LONGEST_PAUSE_S = 10.0  # between two frames of a file

Frames = Iterator[RadarFrame]


def with_waveform_of_source(config: RadarConfig) -> RadarConfig:
    """The configuration with the waveform that its source really has: that of the recording, or the chip's.

    Raises:
        ConfigError: a wrong source or scenario, a missing or broken recording, a waveform that the chip cannot do.
    """
    url = parse_source(config.source, SCHEMES)
    if url.scheme == "file":
        return msgspec.structs.replace(config, waveform=_recording(url).waveform)
    if url.scheme == "mcap":
        return fitted_as_recorded(config, url, RADAR_RAW)
    if url.scheme == "spi":
        return msgspec.structs.replace(config, waveform=plan(config.waveform).waveform)
    ScenarioClock(url)  # refuses a scenario that there is not
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


def _recording(url: SourceUrl) -> Recording:
    try:
        return open_recording(Path(url.target))
    except RecordingError as error:
        raise ConfigError(f"source {url}: {error}") from None


def _replay(recording: Recording, rate: float, *, loop: bool) -> Frames:
    """Recorded frames as if they came now, ``rate`` times as fast; rate 0 does not wait."""
    period_ns = round(recording.waveform.frame_period_s * 1e9)
    into_ns = _into_recording_ns(recording.stamps_ns, period_ns)
    length_ns = int(into_ns[-1]) + period_ns
    start_s, turn = monotonic_s(), 0
    while True:
        for at_ns, (_, frame) in zip(into_ns, recording, strict=True):
            due_s = start_s + (int(at_ns) + turn * length_ns) * 1e-9 / (rate or 1.0)
            if rate > 0:
                wait_until(due_s)
            yield RadarFrame(utc_at(due_s), utc_ns(), frame, epoch=turn, note="")
        if not loop:
            return
        turn += 1


def _into_recording_ns(stamps_ns: np.ndarray, period_ns: int) -> np.ndarray:
    """(N,) int64: when each frame is due after the first, for (N,) UTC ns as recorded.

    The clock may have been set in between: a Raspberry Pi without a network starts years ago. So no pause is longer
    than ``LONGEST_PAUSE_S``, and a frame that goes back in time follows after one period.
    """
    steps_ns = np.diff(stamps_ns)
    steps_ns = np.where(steps_ns < 0, period_ns, np.minimum(steps_ns, round(LONGEST_PAUSE_S * 1e9)))
    return np.concatenate([[0], np.cumsum(steps_ns)])


def _recorded_on_the_bus(url: SourceUrl) -> Frames:
    """Raw frames of ``spotter record --raw radar``, each with the motion that the service had been told."""
    for piece in replayed(url, RADAR_RAW):
        note = str(piece.about.get("note", ""))
        yield RadarFrame(piece.stamp_ns, piece.received_ns, piece.data, piece.epoch, note, recorded_motion(piece))


def _simulate(clock: ScenarioClock, waveform: WaveformConfig, report: Report) -> Frames:
    """The simulated world through the radar's eyes, at the waveform's frame rate; frames that came late are skipped."""
    sampled = simulator_waveform(waveform)
    for due_s in ticks(waveform.frame_period_s, skipped=report.dropped):
        try:
            frame = bgt60.frame(clock.scenario, clock.at(due_s), sampled)
            yield RadarFrame(utc_at(due_s), utc_ns(), frame, epoch=0, note="")
        except DeviceUnplugged as error:
            report.state("disconnected", f"{error}: check the plug; trying again")
        except TimeoutError as error:
            report.state("disconnected", f"{error}: restarting the chip")
