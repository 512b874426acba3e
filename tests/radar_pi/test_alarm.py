"""Levels of tracks: the bands, what never alarms, and properties over all tracks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.messages import LEVELS
from services.radar_pi.alarm import alarm_level, approached_s_ago, is_moving, static_level, time_to_collision_s
from services.radar_pi.config import AlarmConfig, TrackingConfig
from services.radar_pi.tracking import Track

ALARM, TRACKING = AlarmConfig(), TrackingConfig()
NOW_NS = 100_000_000_000


def track(range_m: float, velocity_mps: float, *, approaching: bool, ago_s: float | None = None) -> Track:
    return Track(
        state=np.array([range_m, velocity_mps, 0.0]), covariance=np.eye(3), snr_db=30.0, has_azimuth=True, track_id=1,
        approaching=approaching, last_approach_ns=None if ago_s is None else NOW_NS - round(ago_s * 1e9),
    )  # fmt: skip


def level(subject: Track, alarm: AlarmConfig = ALARM) -> str:
    ttc_s = time_to_collision_s(subject, TRACKING)
    return alarm_level(subject, ttc_s, alarm, TRACKING.moving_mps)


@pytest.mark.parametrize(
    ("range_m", "velocity_mps", "expected"),
    [
        (6.0, -4.1, "IMMINENT"),  # 1.46 s
        (6.0, -4.0, "CAUTION"),  # 1.50 s: not under it
        (4.0, -1.4, "CAUTION"),  # 2.9 s
        (6.0, -2.0, "SAFE"),  # 3.0 s
        (0.5, -0.2, "IMMINENT"),  # within
        (0.51, -0.16, "CAUTION"),
        (1.2, -0.2, "CAUTION"),
        (1.21, -0.2, "SAFE"),
        (0.4, 0.0, "IMMINENT"),  # the gate is still open: it came within reach
    ],
)
def test_bands_of_an_approaching_track(range_m: float, velocity_mps: float, expected: str) -> None:
    assert level(track(range_m, velocity_mps, approaching=True)) == expected


@pytest.mark.parametrize(
    ("range_m", "velocity_mps", "expected"),
    [
        (0.4, 0.0, "CAUTION"),  # appeared there and stands
        (0.5, -0.12, "CAUTION"),  # creeps: too slow for the approach gate
        (0.5, 0.14, "CAUTION"),
        (0.4, 0.15, "SAFE"),  # it leaves
        (0.4, -0.8, "SAFE"),  # fast: the approach gate decides
        (0.51, 0.0, "SAFE"),
    ],
)
def test_very_close_at_near_zero_velocity_is_flagged_regardless(
    range_m: float, velocity_mps: float, expected: str
) -> None:
    for ago_s in (None, 0.3, 60.0):
        assert level(track(range_m, velocity_mps, approaching=False, ago_s=ago_s)) == expected


def test_the_flag_can_be_switched_off() -> None:
    assert level(track(0.4, 0.0, approaching=False), AlarmConfig(flag_very_close=False)) == "SAFE"


def test_the_last_approach_is_told() -> None:
    assert approached_s_ago(track(1.0, 0.0, approaching=False), NOW_NS) is None
    assert approached_s_ago(track(1.0, 0.0, approaching=False, ago_s=0.3), NOW_NS) == pytest.approx(0.3)


@given(st.floats(0.0, 10.0), st.floats(-5.0, 5.0))
def test_without_approach_only_the_very_close_and_slow_alarms(range_m: float, velocity_mps: float) -> None:
    flagged = range_m <= 0.5 and abs(velocity_mps) < TRACKING.moving_mps
    assert level(track(range_m, velocity_mps, approaching=False)) == ("CAUTION" if flagged else "SAFE")


@given(st.floats(0.01, 10.0), st.floats(-5.0, -0.16))
def test_approaching_within_one_and_a_half_seconds_is_always_imminent(range_m: float, velocity_mps: float) -> None:
    if range_m / -velocity_mps < 1.5:
        assert level(track(range_m, velocity_mps, approaching=True)) == "IMMINENT"


@given(st.floats(0.0, 10.0), st.floats(0.0, 1.0), st.floats(-5.0, 5.0))
def test_nearer_is_never_less_serious(range_m: float, step_m: float, velocity_mps: float) -> None:
    nearer = level(track(max(0.0, range_m - step_m), velocity_mps, approaching=True))
    assert LEVELS.index(nearer) >= LEVELS.index(level(track(range_m, velocity_mps, approaching=True)))


@pytest.mark.parametrize(("velocity_mps", "approaching"), [(0.0, True), (-0.1, True), (1.0, True), (-1.0, False)])
def test_no_time_to_collision_unless_it_closes_through_the_gate(velocity_mps: float, approaching: bool) -> None:
    assert time_to_collision_s(track(2.0, velocity_mps, approaching=approaching), TRACKING) is None


def test_a_distance_of_zero_is_a_distance() -> None:
    touching = track(0.0, -1.0, approaching=True)
    assert time_to_collision_s(touching, TRACKING) == 0.0
    assert level(touching) == "IMMINENT"


@pytest.mark.parametrize(
    ("velocity_mps", "ego_mps", "expected"),
    [
        (-1.0, None, True),
        (0.05, None, False),
        (-1.0, 1.0, False),  # a wall ahead while we drive
        (0.0, 1.0, True),  # drives with us
        (0.0, 0.0, False),
    ],
)
def test_moving_is_over_ground_when_our_speed_is_known(
    velocity_mps: float, ego_mps: float | None, expected: bool
) -> None:
    assert is_moving(track(2.0, velocity_mps, approaching=False), ego_mps, TRACKING) is expected


def test_a_wall_ahead_alarms_while_we_drive() -> None:
    """Relative closing counts (A12): standing over ground does not make it harmless."""
    wall = track(1.0, -1.0, approaching=True)
    assert not is_moving(wall, 1.0, TRACKING)
    assert level(wall) == "IMMINENT"


def test_static_level_is_by_distance_of_what_stands() -> None:
    assert static_level([], ALARM) is None
    assert static_level([track(3.0, 0.0, approaching=False)], ALARM) == "SAFE"
    assert static_level([track(r, 0.0, approaching=False) for r in (3.0, 1.2)], ALARM) == "CAUTION"
    assert static_level([track(0.5, 0.0, approaching=False)], ALARM) == "IMMINENT"


def test_the_slowest_closing_that_counts() -> None:
    at = -TRACKING.moving_mps
    assert time_to_collision_s(track(1.5, at, approaching=True), TRACKING) == pytest.approx(1.5 / TRACKING.moving_mps)
    assert time_to_collision_s(track(1.5, at + 1e-6, approaching=True), TRACKING) is None


def test_an_approach_of_this_very_moment_is_no_time_ago() -> None:
    assert approached_s_ago(track(1.0, -1.0, approaching=True, ago_s=0.0), NOW_NS) == 0.0


def test_moving_over_ground_begins_at_its_limit_and_by_the_azimuth() -> None:
    at = TRACKING.moving_mps
    assert is_moving(track(3.0, at, approaching=False), None, TRACKING)
    assert not is_moving(track(3.0, at - 1e-6, approaching=False), None, TRACKING)
    aside = track(3.0, -1.0, approaching=True)  # stands at 60 degrees beside a way of 2 m/s
    aside.state[2] = np.pi / 3
    assert not is_moving(aside, 2.0, TRACKING)
    aside.state[2] = 0.0
    assert is_moving(aside, 2.0, TRACKING)
    aside.has_azimuth = False  # straight ahead where it is not known
    assert is_moving(aside, 1.0 + at + 1e-6, TRACKING)
    assert not is_moving(aside, 1.0 + at - 1e-6, TRACKING)
