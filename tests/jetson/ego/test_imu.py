"""Three gyroscopes at register level, and their bias."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.jetson.ego.gyro import UNKNOWN_BIAS_RADPS, GyroBias
from services.jetson.ego.imu_chips import CHIPS, WrongChip, open_chip
from tests.jetson.ego.imu_emulator import EmulatedImu


def nap(seconds: float) -> None:
    return


@pytest.mark.parametrize("name", CHIPS)
@given(st.floats(-499.0, 499.0))
def test_the_rate_of_each_axis_comes_out_in_radians(name: str, dps: float) -> None:
    for axis in range(3):
        rates = [0.0, 0.0, 0.0]
        rates[axis] = dps
        bus = EmulatedImu(name, lambda rates=rates: tuple(rates))  # type: ignore[misc]
        open_chip(CHIPS[name], bus, nap)
        raw = CHIPS[name].read(bus)
        assert raw[axis] * CHIPS[name].radps_per_lsb == pytest.approx(math.radians(dps), abs=0.002)
        assert [value for i, value in enumerate(raw) if i != axis] == [0, 0]


@pytest.mark.parametrize("name", CHIPS)
def test_a_chip_that_was_not_set_up_gives_nothing(name: str) -> None:
    bus = EmulatedImu(name, lambda: (0.0, 0.0, 100.0))
    assert CHIPS[name].read(bus)[2] == 0


@pytest.mark.parametrize("name", CHIPS)
def test_more_than_it_can_measure_is_saturated(name: str) -> None:
    bus = EmulatedImu(name, lambda: (0.0, 0.0, 3000.0))
    open_chip(CHIPS[name], bus, nap)
    assert CHIPS[name].read(bus)[2] >= CHIPS[name].full_scale


def test_another_chip_and_an_absent_one_are_told_apart() -> None:
    bus = EmulatedImu("bno055", lambda: (0.0, 0.0, 0.0))
    with pytest.raises(WrongChip, match="identity 0x00 where mpu6050 has 0x68"):
        open_chip(CHIPS["mpu6050"], bus, nap)
    bus.present = False
    with pytest.raises(OSError, match="Remote I/O"):
        open_chip(CHIPS["bno055"], bus, nap)


def test_the_bias_is_learned_at_standstill_and_kept_on_the_way() -> None:
    bias, dice = GyroBias(), random.Random(1)
    now_s = 0.0
    assert bias.correct(now_s, 0.05, standing=True) == (0.05, UNKNOWN_BIAS_RADPS)
    for _ in range(150):
        now_s += 0.01
        bias.correct(now_s, 0.05 + dice.gauss(0, 0.003), standing=True)
    turning, sigma = bias.correct(now_s, 0.55, standing=False)
    assert turning == pytest.approx(0.5, abs=0.005)
    assert sigma < 0.02


def test_nothing_is_learned_while_driving_or_in_a_curve() -> None:
    for standing, raw in ((False, 0.05), (None, 0.3)):
        bias = GyroBias()
        for i in range(300):
            bias.correct(0.01 * i, raw, standing=standing)
        assert bias.bias_radps is None
