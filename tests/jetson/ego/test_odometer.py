"""What can be true, which device counts, and what is said of the others."""

from __future__ import annotations

import pytest

from services.jetson.ego.config import EgoConfig, LimitsConfig
from services.jetson.ego.measurement import Measurement
from services.jetson.ego.pipeline import EgoPipeline, Odometer
from services.jetson.ego.plausible import Limits, SignalCheck

LIMITS = Limits(maximum=15.0, rate=30.0, stuck_s=1.0)


def faults(values: list[float], limits: Limits = LIMITS, period_s: float = 0.05) -> list[str]:
    check = SignalCheck(limits)
    return [check.fault(period_s * i, value) for i, value in enumerate(values)]


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([1.0, 1.1, 1.2], ["", "", ""]),
        ([1.0, 16.0, 1.1], ["", "nonsense", ""]),
        ([1.0, float("nan"), 1.1], ["", "nonsense", ""]),
        ([1.0, 9.0, 1.2], ["", "jump", ""]),
        ([1.0, 9.0, 9.1, 9.2, 9.3], ["", "jump", "jump", "", ""]),  # three that agree: the jump was real
        ([1.0, -14.0, 14.0, -14.0, 14.0], ["", "jump", "jump", "jump", "jump"]),
    ],
)
def test_nonsense_and_jumps(values: list[float], expected: list[str]) -> None:
    assert faults(values) == expected


def test_a_value_that_never_changes_is_stuck_unless_it_may_rest() -> None:
    assert faults([1.5] * 30)[-1] == "stuck"
    assert faults([1.5] * 30)[15] == ""
    assert set(faults([0.0] * 30)) == {""}
    assert faults([0.0] * 30, LIMITS._replace(noisy=True))[-1] == "stuck"
    assert faults([1.5] * 30 + [1.51])[-1] == ""


def speed(at_s: float, value: float, origin: str = "serial") -> Measurement:
    return Measurement(at_s, origin, speed_mps=value)


def test_the_first_device_counts_and_the_next_one_stands_in() -> None:
    odometer = Odometer(EgoConfig(), ["encoder", "vesc"])
    odometer.take(speed(1.0, 2.0, "vesc"))
    odometer.take(speed(1.0, 1.9, "encoder"))
    motion = odometer.motion(1.1, {})
    assert (motion.speed_mps, motion.speed_origin, motion.reason) == (1.9, "encoder", "")
    odometer.take(speed(1.4, 2.1, "vesc"))
    motion = odometer.motion(1.5, {"encoder": "gpio:x: gone"})
    assert (motion.speed_mps, motion.speed_origin, motion.reason) == (2.1, "vesc", "gpio:x: gone")


@pytest.mark.parametrize(
    ("last", "now_s", "lost", "reason"),
    [
        (None, 1.0, {}, "serial: no data yet"),
        (speed(1.0, 1.0), 2.0, {}, "serial: silent for 1.0 s, the device is there"),
        (speed(1.0, 1.0), 2.0, {"serial": "/dev/x is gone: unplugged?"}, "/dev/x is gone: unplugged?"),
        (speed(1.0, 99.0), 1.1, {}, "serial speed nonsense: not used"),
    ],
)
def test_why_the_motion_is_unknown(last: Measurement | None, now_s: float, lost: dict[str, str], reason: str) -> None:
    odometer = Odometer(EgoConfig(), ["serial"])
    if last is not None:
        odometer.take(last)
    motion = odometer.motion(now_s, lost)
    assert (motion.speed_mps, motion.reason) == (None, reason)
    message = EgoPipeline(EgoConfig()).process(5, motion)
    assert (message.state, message.reason, message.speed_mps, message.speed_origin) == ("degraded", reason, None, "")


def test_a_stuck_speed_is_unknown_at_once() -> None:
    odometer = Odometer(EgoConfig(limits=LimitsConfig(stuck_s=1.0)), ["serial"])
    taken = [odometer.take(speed(0.05 * i, 2.0)) for i in range(30)]
    assert taken[-1] == ["serial speed stuck"]
    assert odometer.motion(1.45, {}).speed_mps is None


def test_an_encoder_and_a_gyroscope_together() -> None:
    odometer = Odometer(EgoConfig(), ["encoder", "imu"])
    for i in range(300):
        odometer.take(Measurement(0.01 * i, "encoder", speed_mps=0.0, speed_sigma_mps=0.01))
        odometer.take(Measurement(0.01 * i, "imu", yaw_rate_radps=0.04 + 1e-4 * (i % 3)))
    odometer.take(Measurement(3.0, "encoder", speed_mps=0.5, speed_sigma_mps=0.02))
    odometer.take(Measurement(3.0, "imu", yaw_rate_radps=0.34))
    motion = odometer.motion(3.0, {})
    assert (motion.speed_mps, motion.speed_sigma_mps) == (0.5, 0.02)
    assert motion.yaw_rate_radps == pytest.approx(0.3, abs=0.01)
    assert (motion.speed_origin, motion.yaw_rate_origin, motion.reason) == ("encoder", "imu", "")
