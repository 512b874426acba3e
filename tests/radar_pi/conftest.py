"""The emulated chip on a clock that tests run by hand."""

from __future__ import annotations

import pytest

from services.radar_pi import signals
from services.radar_pi.emulator import EmulatedChip
from services.radar_pi.manual_clock import ManualClock


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
def chip(clock: ManualClock) -> EmulatedChip:
    """A healthy chip on a 50 MHz bus that receives noise."""
    return EmulatedChip(clock, signals.noise(seed=1), speed_hz=50_000_000)
