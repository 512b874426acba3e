"""When the radar says that it cannot see, why, and when it sees again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from services.radar_pi.config import HealthConfig
from services.radar_pi.health import Health, HealthMonitor, Signals, chirp_spread_db, saturated_fraction

CONFIG = HealthConfig(learn_frames=5, hold_frames=4, saturated_frames=4)
GOOD = Signals(saturated=0.0, noise_floor_db=16.0, leakage_db=60.0)


def watch(monitor: HealthMonitor, frames: int, settled: bool = True, **changed: float) -> list[Health]:
    return [monitor.judge(settled, replace(GOOD, **changed)) for _ in range(frames)]


def learned(config: HealthConfig = CONFIG) -> HealthMonitor:
    monitor = HealthMonitor(config)
    assert all(health.state == "online" for health in watch(monitor, config.learn_frames))
    return monitor


def test_settling_is_degraded() -> None:
    health = HealthMonitor(CONFIG).judge(False, GOOD)
    assert (health.state, health.reason) == ("degraded", "settling: the background is not learned yet")


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"noise_floor_db": 26.0}, "noise floor +10 dB off its learned value: interference or another gain"),
        ({"noise_floor_db": 4.0}, "noise floor -12 dB off its learned value: receiver detuned or without supply"),
        ({"leakage_db": 75.0}, "static clutter at the antenna +15 dB off its learned value: antenna covered"),
        ({"leakage_db": 40.0}, "static clutter at the antenna -20 dB off its learned value"),
        ({"saturated": 0.2}, "saturated: samples at the converter's limits"),
        ({"chirp_spread_db": 12.0}, "interference: chirps of one frame differ by 12 dB"),
    ],
)
def test_a_lasting_deviation_is_degraded_with_its_reason(changed: dict[str, float], expected: str) -> None:
    states = watch(learned(), 6, **changed)
    assert [health.state for health in states] == ["online"] * 3 + ["degraded"] * 3
    assert expected in states[-1].reason


def test_a_short_deviation_is_not() -> None:
    monitor = learned()
    for _ in range(5):
        assert all(health.state == "online" for health in watch(monitor, 3, noise_floor_db=30.0))
        watch(monitor, 3)


def test_three_good_frames_recover() -> None:
    monitor = learned()
    watch(monitor, 6, noise_floor_db=30.0)
    assert [health.state for health in watch(monitor, 4)] == ["degraded", "degraded", "online", "online"]
    assert watch(monitor, 3, noise_floor_db=30.0)[-1].state == "online"


def test_nothing_is_learned_while_settling() -> None:
    monitor = HealthMonitor(CONFIG)
    watch(monitor, 20, settled=False, noise_floor_db=50.0)
    watch(monitor, CONFIG.learn_frames)
    assert watch(monitor, 6)[-1].state == "online"


def test_known_values_need_no_learning() -> None:
    monitor = HealthMonitor(HealthConfig(noise_floor_db=16.0, leakage_db=60.0, hold_frames=4))
    assert watch(monitor, 4, leakage_db=75.0)[-1].state == "degraded"


def test_the_drivers_note_is_passed_on() -> None:
    health = learned().judge(True, GOOD, "interrupt line is dead: polling")
    assert (health.state, health.reason) == ("degraded", "interrupt line is dead: polling")


def test_saturation_counts_both_ends() -> None:
    frame = np.full((1, 2, 50), 2048, np.uint16)
    frame[0, 0, :3], frame[0, 1, :2] = 0, 4095
    assert saturated_fraction(frame) == pytest.approx(0.05)


def test_the_spread_of_the_chirps_is_told_in_db() -> None:
    moving = np.ones((2, 10, 5), np.complex64)
    assert chirp_spread_db(moving) == pytest.approx(0.0)
    moving[:, 5:] *= 10.0
    assert chirp_spread_db(moving) == pytest.approx(20.0)
    assert chirp_spread_db(np.zeros((2, 10, 5), np.complex64)) == 0.0
