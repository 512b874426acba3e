"""The vehicle's motion as a sensor knows it: only while arrival and stamp are fresh, and with an honest uncertainty."""

from __future__ import annotations

import math
from typing import Any

import pytest

from common.bus.ego import EgoWatch, motion_at, motion_of
from common.bus.pubsub import Received
from common.clock import monotonic_s, utc_ns
from common.messages import EgoMotion, Motion
from common.path import YAW_UNKNOWN_RADPS, PathConfig

CONFIG = PathConfig()
NOW_NS = 1_800_000_000_000_000_000


def ego_motion(speed_mps: float | None = 1.5, stamp_ns: int = NOW_NS, **fields: Any) -> EgoMotion:
    return EgoMotion(stamp_ns=stamp_ns, speed_mps=speed_mps, yaw_rate_radps=fields.pop("yaw_rate_radps", 0.2), **fields)


@pytest.mark.parametrize(
    ("arrived_ago_s", "stamped_ago_s", "known"),
    [
        (0.0, 0.0, True),
        (0.5, 0.5, True),
        (0.51, 0.3, False),  # nothing came for too long
        (0.0, 0.51, False),  # an old message sent again
        (0.0, 3600.0, False),
        (0.0, -0.1, True),
        (0.0, -0.2, False),  # from the future
    ],
)
def test_only_fresh_motion_is_known(arrived_ago_s: float, stamped_ago_s: float, known: bool) -> None:
    message = ego_motion(stamp_ns=NOW_NS - round(stamped_ago_s * 1e9))
    motion = motion_at(Received("k", message, 100.0 - arrived_ago_s, 0), 100.0, NOW_NS, CONFIG)
    assert (motion is not None) is known


def test_nobody_tells() -> None:
    assert motion_at(None, 100.0, NOW_NS, CONFIG) is None


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (ego_motion(), Motion(1.5, 0.2, 0.02, 0.02)),
        (ego_motion(speed_sigma_mps=0.01, yaw_rate_sigma_radps=0.02), Motion(1.5, 0.2, 0.01, 0.02)),
        (ego_motion(None), None),
        (ego_motion(state="degraded", reason="implausible"), None),
        (ego_motion(yaw_rate_radps=None), Motion(1.5, 0.0, 0.02, YAW_UNKNOWN_RADPS)),
        (ego_motion(yaw_rate_radps=None, steering_rad=0.0), Motion(1.5, 0.0, 0.02, 0.05)),
        (ego_motion(-1.0), Motion(-1.0, 0.2, 0.02, 0.02)),
    ],
)
def test_what_a_message_says(message: EgoMotion, expected: Motion | None) -> None:
    assert motion_of(message, CONFIG) == expected


def test_a_steering_angle_gives_the_yaw_rate_of_a_single_track() -> None:
    motion = motion_of(ego_motion(2.0, yaw_rate_radps=None, steering_rad=0.2), CONFIG)
    assert motion is not None
    assert motion.yaw_rate_radps == pytest.approx(2.0 * math.tan(0.2) / CONFIG.wheelbase_m)


class Subscription:
    def __init__(self) -> None:
        self.waiting: list[Received[EgoMotion]] = []

    def take(self) -> list[Received[EgoMotion]]:
        taken, self.waiting = self.waiting, []
        return taken


def test_the_newest_message_counts_until_the_next() -> None:
    subscription = Subscription()
    watch = EgoWatch(subscription, CONFIG)  # type: ignore[arg-type]
    assert watch.now() is None
    now_s = monotonic_s()
    subscription.waiting = [Received("k", ego_motion(speed, utc_ns()), now_s, 0) for speed in (1.0, 2.0)]
    for _ in range(2):
        motion = watch.now()
        assert motion is not None
        assert motion.speed_mps == 2.0
