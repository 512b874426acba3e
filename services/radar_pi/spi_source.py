"""``spi:0.0`` and ``spi:emulator`` -> frames; a chip that is lost is opened again, with growing pauses."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import closing

import msgspec

from common.backoff import Backoff
from common.bus.status import Report
from common.config import ConfigError
from services.radar_pi.chip.chip import RadarFault
from services.radar_pi.chip.driver import Driver, RadarFrame
from services.radar_pi.chip.exports import Plan, plan
from services.radar_pi.chip.link import Clock, Link, SystemClock
from services.radar_pi.config import RadarConfig, SpiConfig
from services.radar_pi.emulator import signals
from services.radar_pi.emulator.emulator import EmulatedChip

log = logging.getLogger("driver")

FIRST_RETRY_S = 0.2
LAST_RETRY_S = 5.0


def open_spi(target: str, config: RadarConfig, report: Report) -> Iterator[RadarFrame]:
    """Frames of ``BUS.DEVICE`` or of the emulated chip (``emulator``, ``emulator/SCENARIO``, ``emulator/noise``).

    Without a target it is ``[spi] bus`` and ``device``.

    Raises:
        ConfigError: an unknown target, or a waveform that the chip cannot do.
    """
    clock = SystemClock()
    return keep_open(link_opener(target, config.spi, clock), clock, plan(config.waveform), config.spi.speed_hz, report)


def link_opener(target: str, config: SpiConfig, clock: Clock) -> Callable[[], Link]:
    """What opens the link that the target names."""
    kind, _, scenario = target.partition("/")
    if kind == "emulator":
        signal = signals.noise() if scenario == "noise" else _world(scenario or "crossing")
        return lambda: EmulatedChip(clock, signal)
    bus, dot, device = (target or f"{config.bus}.{config.device}").partition(".")
    if not (dot and bus.isdigit() and device.isdigit()):
        raise ConfigError(f"source spi:{target}: expected spi:BUS.DEVICE (spi:0.0) or spi:emulator")
    wired = msgspec.structs.replace(config, bus=int(bus), device=int(device))

    def open_hardware() -> Link:
        from services.radar_pi.chip.hardware import SpiLink

        return SpiLink(wired)

    return open_hardware


def keep_open(
    open_link: Callable[[], Link], clock: Clock, what: Plan, speed_hz: int, report: Report
) -> Iterator[RadarFrame]:
    """Frames for ever. While there is no chip the state is "disconnected", with the reason and bounded retries."""
    epoch, backoff = 1, Backoff(FIRST_RETRY_S, LAST_RETRY_S)
    while True:
        try:
            driver = Driver(open_link(), clock, what, speed_hz, report, epoch)
            with closing(driver.frames()) as frames:
                for frame in frames:
                    epoch = frame.epoch + 1
                    backoff.reset()
                    yield frame
        except (RadarFault, OSError) as error:
            wait_s = backoff.next_s()
            report.bad_input(error.name if isinstance(error, RadarFault) else "bus_lost")
            report.state("disconnected", f"radar: {error}; next try in {wait_s:g} s")
            log.error("%s; next try in %g s", error, wait_s)
            clock.sleep(wait_s)


def _world(scenario: str) -> signals.SignalSource:
    try:
        return signals.world(scenario)
    except ValueError as error:
        raise ConfigError(f"source spi:emulator/{scenario}: {error}") from None
