"""How long a level outlives its cause: bounds that follow from the configuration, on ideal measurements."""

from __future__ import annotations

import numpy as np
import pytest

from common.messages import Level, worst
from services.radar_pi.alarm import alarm_level, time_to_collision_s
from services.radar_pi.config import AlarmConfig, DetectionConfig, TrackingConfig
from services.radar_pi.detection import Detection
from services.radar_pi.tracking import Tracker

TRACKING, ALARM = TrackingConfig(), AlarmConfig()
PERIOD_NS = 100_000_000
GATE_FRAMES, MISSES = TRACKING.approach_frames, TRACKING.delete_misses


def levels(path: list[tuple[float, float] | None]) -> list[Level]:
    """The worst level of every frame for a body that is at (range, velocity), or not there."""
    tracker = Tracker(TRACKING, DetectionConfig(), v_max_mps=5.15)
    reported: list[Level] = []
    for i, body in enumerate(path):
        stamp_ns = i * PERIOD_NS
        tracks = tracker.update(stamp_ns, [] if body is None else [Detection(*body, 0.0, 30.0)])
        times = [(track, time_to_collision_s(track, TRACKING)) for track in tracks]
        reported.append(worst(*(alarm_level(track, ttc_s, ALARM, TRACKING.moving_mps) for track, ttc_s in times)))
    return reported


def approach_to(range_m: float, speed_mps: float) -> list[tuple[float, float] | None]:
    """From 20 frames away to ``range_m``."""
    return [(range_m + i * 0.1 * speed_mps, -speed_mps) for i in range(20, -1, -1)]


@pytest.mark.parametrize(("range_m", "speed_mps"), [(0.4, 1.4), (1.0, 1.4), (0.3, 4.0), (2.0, 4.0)])
def test_a_body_that_is_gone_is_let_go_with_its_third_miss(range_m: float, speed_mps: float) -> None:
    """It may have been lost at arm's length: the coasting track keeps its level, and no frame longer."""
    coming = approach_to(range_m, speed_mps)
    reported = levels([*coming, *[None] * 10])
    assert reported[len(coming) - 1] == "IMMINENT"
    assert reported[len(coming) :] == ["IMMINENT"] * (MISSES - 1) + ["SAFE"] * (10 - MISSES + 1)


@pytest.mark.parametrize(("range_m", "speed_mps"), [(0.7, 0.7), (1.0, 1.4), (2.0, 2.4)])
def test_a_body_that_turns_round_is_let_go_when_the_gate_shuts(range_m: float, speed_mps: float) -> None:
    coming = approach_to(range_m, speed_mps)
    going = [(range_m + i * 0.1 * speed_mps, speed_mps) for i in range(1, 11)]
    reported = levels([*coming, *going])
    assert reported[len(coming) - 1] == "IMMINENT"
    assert set(reported[len(coming) + GATE_FRAMES :]) == {"SAFE"}


def test_a_body_that_stops_very_close_stays_caution() -> None:
    coming = approach_to(0.4, 1.0)
    stopped = levels([*coming, *[(0.4, 0.0)] * 40])[len(coming) :]
    assert set(stopped[: GATE_FRAMES - 1]) <= {"IMMINENT"}
    assert set(stopped[GATE_FRAMES:]) == {"CAUTION"}


def test_a_body_that_stops_farther_away_is_let_go_when_the_gate_shuts() -> None:
    coming = approach_to(0.9, 1.0)
    reported = levels([*coming, *[(0.9, 0.0)] * 20])
    assert reported[len(coming) - 1] == "IMMINENT"
    assert set(reported[len(coming) + GATE_FRAMES :]) == {"SAFE"}


def test_a_body_that_passes_is_let_go() -> None:
    """It comes to 0.5 m beside the radar and goes on: range rate turns within a few frames."""
    s = np.arange(-3.0, 3.0, 0.14)
    range_m = np.hypot(s, 0.5)
    path: list[tuple[float, float] | None] = [(float(r), float(1.4 * x / r)) for x, r in zip(s, range_m, strict=True)]
    reported = levels(path)
    last = max(i for i, level in enumerate(reported) if level == "IMMINENT")
    assert s[last] <= 0.14 * GATE_FRAMES
    assert set(reported[last + 1 + GATE_FRAMES :]) == {"SAFE"}
