"""Devices that cannot be reached, and settings that cannot be."""

from __future__ import annotations

import pytest

from common.config import ConfigError
from common.source_url import parse_source
from services.jetson.ego.config import EgoConfig
from services.jetson.ego.devices import Encoder, Imu
from services.jetson.ego.source import SCHEMES
from tests.jetson.ego.imu_emulator import EmulatedImu


def test_every_attempt_to_reach_a_gyroscope_lets_go_of_the_bus() -> None:
    """One left open with each attempt, and after half an hour without the chip no file can be opened any more."""
    chip = EmulatedImu("mpu6050", lambda: (0.0, 0.0, 20.0))
    chip.present = False
    device = Imu(parse_source("imu:mpu6050", SCHEMES), EgoConfig(), lambda bus, address: chip)
    for attempt in range(1, 4):
        with pytest.raises(OSError, match="Errno 121"):
            next(iter(device.readings()))
        assert chip.closed == attempt


@pytest.mark.parametrize("lines", ["a=5&b=5", "a=-1", "a=5&b=-2"])
def test_lines_of_an_encoder_that_cannot_be(lines: str) -> None:
    with pytest.raises(ConfigError, match="to be different lines, 0 or more"):
        Encoder(parse_source(f"gpio:/dev/gpiochip0?{lines}", SCHEMES), EgoConfig())
