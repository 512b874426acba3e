"""Edges of a wheel encoder against a wheel that turns as it is told."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.jetson.ego.config import EncoderConfig
from services.jetson.ego.wheel import WheelEncoder

CONFIG = EncoderConfig(pulses_per_m=100.0)
QUADRATURE = [("a", True), ("b", True), ("a", False), ("b", False)]


def turn(wheel: WheelEncoder, speed_mps: float, seconds: float, start_s: float = 0.0, two: bool = True) -> float:
    """Edges of a wheel at a constant speed; the time of the last."""
    per_m = CONFIG.pulses_per_m * 4
    steps = int(abs(speed_mps) * per_m * seconds)
    at_s = start_s
    for step in range(1, steps + 1):
        at_s = start_s + step / (per_m * abs(speed_mps))
        channel, rising = QUADRATURE[(step - 1) % 4] if speed_mps > 0 else reverse(step)
        if two or channel == "a":
            wheel.edge(at_s, channel, rising=rising)
    return at_s


def reverse(step: int) -> tuple[str, bool]:
    return [("b", True), ("a", True), ("b", False), ("a", False)][(step - 1) % 4]


@given(st.floats(0.1, 10.0), st.booleans())
def test_a_constant_speed_is_found_with_its_direction(speed_mps: float, backward: bool) -> None:
    wheel = WheelEncoder(CONFIG, two=True)
    last_s = turn(wheel, -speed_mps if backward else speed_mps, 1.0)
    speed, sigma = wheel.speed(last_s)
    assert speed == pytest.approx(-speed_mps if backward else speed_mps, rel=0.02)
    assert 0.0 < sigma < 0.03 * speed_mps + 0.1
    assert (wheel.missed, wheel.bounced, wheel.silent_channel) == (0, 0, "")


@given(st.floats(0.1, 10.0))
def test_one_channel_knows_no_direction(speed_mps: float) -> None:
    wheel = WheelEncoder(CONFIG, two=False)
    last_s = turn(wheel, -speed_mps, 1.0, two=False)
    assert wheel.speed(last_s)[0] == pytest.approx(speed_mps, rel=0.05)


def test_without_pulses_it_slows_down_and_stands() -> None:
    wheel = WheelEncoder(CONFIG, two=True)
    assert wheel.speed(5.0)[0] == 0.0
    last_s = turn(wheel, 2.0, 1.0)
    speeds = [wheel.speed(last_s + dt_s)[0] for dt_s in (0.0, 0.01, 0.1, 0.3, 0.5)]
    assert speeds[0] == pytest.approx(2.0, rel=0.02)
    assert speeds[1] == pytest.approx(0.25)  # not one count in 10 ms: at most 2.5 mm in that time
    assert sorted(speeds, reverse=True) == speeds
    assert speeds[-1] == 0.0


def test_turning_round_is_seen() -> None:
    wheel = WheelEncoder(CONFIG, two=True)
    last_s = turn(wheel, 1.0, 1.0)
    last_s = turn(wheel, -1.0, 1.0, last_s)
    assert wheel.speed(last_s)[0] == pytest.approx(-1.0, rel=0.02)


def test_contact_bounce_is_counted_and_makes_no_speed() -> None:
    wheel = WheelEncoder(CONFIG, two=False)
    for i in range(50):
        for bounce_s in (0.0, 20e-6, 50e-6):
            wheel.edge(0.01 * i + bounce_s, "a", rising=True)
    assert wheel.speed(0.49)[0] == pytest.approx(1.0, rel=0.02)
    assert wheel.bounced == 100


def test_a_broken_channel_is_named_and_is_no_standstill() -> None:
    wheel = WheelEncoder(CONFIG, two=True)
    turn(wheel, 1.0, 0.1)
    for i in range(10):
        wheel.edge(1.0 + 0.01 * i, "a", rising=bool(i % 2))
    assert wheel.silent_channel == "b"
