"""The glue to spidev and gpiod, with stand-ins for the two libraries whose other end is the emulated chip.

This holds the calls and their order; a real bus, real edges and real timing need the HAT.
"""

from __future__ import annotations

import itertools
import sys
from contextlib import closing
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from common.bus.status import Report
from services.radar_pi.chip.driver import Driver
from services.radar_pi.chip.exports import plan
from services.radar_pi.chip.hardware import HardwareError, SpiLink
from services.radar_pi.config import SpiConfig, WaveformConfig
from services.radar_pi.emulator.emulator import EmulatedChip

SMALL = plan(WaveformConfig(samples=64, chirps=16, sample_rate_hz=2e6, chirp_period_s=0.2e-3, frame_period_s=0.02))


class Bus:
    """What ``spidev.SpiDev`` offers to the driver."""

    def __init__(self, chip: EmulatedChip) -> None:
        self._chip = chip
        self.opened: tuple[int, int] | None = None
        self.mode = self.max_speed_hz = -1
        self.closed = False

    def open(self, bus: int, device: int) -> None:
        self.opened = bus, device

    def xfer2(self, values: list[int]) -> list[int]:
        assert self.mode == 0
        return list(self._chip.transfer(bytes(values)))

    def close(self) -> None:
        self.closed = True


class Lines:
    """What ``gpiod.request_lines`` returns: reset on GPIO12 (output), interrupt on GPIO25 (input)."""

    def __init__(self, chip: EmulatedChip) -> None:
        self._chip = chip
        self.released = False
        self.edges = 0

    def set_value(self, line: int, value: str) -> None:
        assert line == 12
        self._chip.set_reset(active=value == "inactive")

    def get_value(self, line: int) -> str:
        assert line == 25
        return "active" if self._chip.wait_irq(0.0) else "inactive"

    def wait_edge_events(self, timeout: float) -> bool:
        self.edges += 1
        return self._chip.wait_irq(timeout)

    def read_edge_events(self) -> list[object]:
        return [object()]

    def release(self) -> None:
        self.released = True


@pytest.fixture
def libraries(monkeypatch, chip):
    """Both libraries as far as the driver uses them."""
    line = ModuleType("gpiod.line")
    line.Direction = SimpleNamespace(OUTPUT="out", INPUT="in")
    line.Value = SimpleNamespace(ACTIVE="active", INACTIVE="inactive")
    line.Edge = SimpleNamespace(RISING="rising")
    gpiod, spidev = ModuleType("gpiod"), ModuleType("spidev")
    gpiod.line = line
    gpiod.LineSettings = lambda **settings: settings
    made = SimpleNamespace(bus=Bus(chip), lines=Lines(chip), requests=[])

    def request_lines(path: str, consumer: str, config: dict) -> Lines:
        made.requests.append((path, consumer, config))
        return made.lines

    gpiod.request_lines = request_lines
    labels = {"/dev/gpiochip0": "gpio-brcmstb@107d508500", "/dev/gpiochip4": "pinctrl-rp1"}
    monkeypatch.setattr("services.radar_pi.chip.hardware.labels", lambda _: labels)
    made.labels = labels
    spidev.SpiDev = lambda: made.bus
    for name, module in {"spidev": spidev, "gpiod": gpiod, "gpiod.line": line}.items():
        monkeypatch.setitem(sys.modules, name, module)
    return made


def test_frames_come_through_spidev_and_gpiod(libraries, clock, chip, monkeypatch) -> None:
    monkeypatch.setattr("services.radar_pi.chip.hardware.monotonic_s", clock.monotonic_s)
    link = SpiLink(SpiConfig())
    assert libraries.bus.opened == (0, 0)
    assert libraries.bus.max_speed_hz == 50_000_000
    ((path, consumer, config),) = libraries.requests
    assert (path, consumer) == ("/dev/gpiochip4", "spotter-radar")  # the header's, though it is not the first
    assert config == {
        12: {"direction": "out", "output_value": "active"},
        25: {"direction": "in", "edge_detection": "rising"},
    }
    with closing(Driver(link, clock, SMALL, 50_000_000, Report("test")).frames()) as frames:
        stamps = [frame.stamp_ns for frame in itertools.islice(frames, 4)]
        assert np.diff(stamps) == pytest.approx(SMALL.timing.frame_period_s * 1e9, abs=2e3)
    assert libraries.bus.closed
    assert libraries.lines.released
    assert libraries.lines.edges > 0


def test_lines_held_by_somebody_else_close_the_bus(libraries, monkeypatch) -> None:
    def busy(path: str, consumer: str, config: dict) -> None:
        raise OSError(16, "Device or resource busy")

    monkeypatch.setattr(sys.modules["gpiod"], "request_lines", busy)
    with pytest.raises(HardwareError, match="GPIO 12, 25 of /dev/gpiochip4: Device or resource busy; does another"):
        SpiLink(SpiConfig())
    assert libraries.bus.closed


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (FileNotFoundError(), r"/dev/spidev0\.0 is missing: dtparam=spi=on"),
        (PermissionError(), "this user is not in group spi"),
    ],
)
def test_a_bus_that_is_not_there_says_what_to_do(libraries, monkeypatch, error: OSError, text: str) -> None:
    def refuse(bus: int, device: int) -> None:
        raise error

    monkeypatch.setattr(libraries.bus, "open", refuse)
    with pytest.raises(HardwareError, match=text):
        SpiLink(SpiConfig())


def test_without_a_header_the_chips_are_named(libraries) -> None:
    libraries.labels.clear()
    libraries.labels["/dev/gpiochip0"] = "tegra234-gpio"
    with pytest.raises(HardwareError, match=r'found /dev/gpiochip0 \(tegra234-gpio\); name it: \[spi\] gpio_chip = "'):
        SpiLink(SpiConfig())
    assert libraries.bus.closed


def test_a_path_is_taken_as_it_is(libraries) -> None:
    SpiLink(SpiConfig(gpio_chip="/dev/gpiochip7"))
    assert libraries.requests[0][0] == "/dev/gpiochip7"
