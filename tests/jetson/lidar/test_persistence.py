"""Three scans to raise, four to clear, per band, in scans and in time."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.jetson.lidar.config import PersistenceSection, ZonesSection
from services.jetson.lidar.persistence import LanePersistence, Silence
from services.jetson.lidar.zones import level_of

FREE = math.inf
LIMITS = (("IMMINENT", 0.8), ("CAUTION", 1.8))


def run(distances: list[float], hz: float = 10.0, config: PersistenceSection | None = None) -> list[str]:
    lane = LanePersistence(config or PersistenceSection())
    return [
        level_of(lane.update(10**18 + int(n * 1e9 / hz), distance), ZonesSection())
        for n, distance in enumerate(distances)
    ]


def counters(distances: list[float]) -> list[str]:
    """The obvious way: two counters for each band."""
    active = {name: False for name, _ in LIMITS}
    streak = {name: [0, 0] for name, _ in LIMITS}
    levels = []
    for distance in distances:
        for name, limit in LIMITS:
            inside = distance <= limit
            streak[name] = [streak[name][0] + 1, 0] if inside else [0, streak[name][1] + 1]
            if streak[name][0] >= 3:
                active[name] = True
            if streak[name][1] >= 4:
                active[name] = False
        levels.append(next((name for name, _ in LIMITS if active[name]), "SAFE"))
    return levels


S, C, I = "SAFE", "CAUTION", "IMMINENT"  # noqa: E741


@pytest.mark.parametrize(
    ("name", "distances", "expected"),
    [
        ("three raise", [0.5] * 3, [S, S, I]),
        ("two do not", [0.5, 0.5, FREE, FREE], [S, S, S, S]),
        ("a gap starts the count anew", [0.5, 0.5, FREE, 0.5, 0.5, 0.5], [S, S, S, S, S, I]),
        ("four clear", [0.5] * 3 + [FREE] * 4, [S, S, I, I, I, I, S]),
        ("three do not", [0.5] * 3 + [FREE] * 3 + [0.5], [S, S, I, I, I, I, I]),
        ("from CAUTION to IMMINENT takes three of its own", [1.5] * 3 + [0.5] * 3, [S, S, C, C, C, I]),
        ("from IMMINENT down to CAUTION takes four", [0.5] * 3 + [1.5] * 4, [S, S, I, I, I, I, C]),
        ("mixed scans are CAUTION together", [0.5, 1.5, 0.5], [S, S, C]),
    ],
)
def test_by_table(name: str, distances: list[float], expected: list[str]) -> None:
    assert run(distances) == expected, name


@given(st.lists(st.sampled_from([0.3, 0.8, 0.81, 1.2, 1.8, 1.81, 2.5, FREE]), max_size=60))
def test_one_distance_equals_counters_for_each_band(distances: list[float]) -> None:
    assert run(distances) == counters(distances)


@pytest.mark.parametrize(
    ("hz", "raised_after", "cleared_after"), [(13.0, 3, 4), (10.0, 3, 4), (5.0, 3, 2), (4.0, 3, 2)]
)
def test_time_bounds_the_count_when_the_sensor_is_slow(hz: float, raised_after: int, cleared_after: int) -> None:
    levels = run([0.5] * 6 + [FREE] * 6, hz)
    # The very first scan has no predecessor, so its own length is unknown and does not count
    assert levels.index(I) + 1 == raised_after
    assert levels[6:].index(S) + 1 == cleared_after


def test_scans_far_apart_are_not_consecutive() -> None:
    lane = LanePersistence(PersistenceSection())
    agreed = [lane.update(10**18 + n * 2 * 10**9, 0.5) for n in range(10)]
    assert set(agreed) == {FREE}


def test_persistence_can_be_switched_off() -> None:
    off = PersistenceSection(raise_scans=1, clear_scans=1)
    assert run([0.5, FREE, 1.5, FREE], config=off) == [I, S, C, S]


def test_the_agreed_distance_follows_an_approach_two_scans_late() -> None:
    lane = LanePersistence(PersistenceSection())
    distances = [2.0 - 0.1 * n for n in range(15)]
    agreed = [lane.update(10**18 + n * 10**8, distance) for n, distance in enumerate(distances)]
    assert agreed[2:] == distances[:-2]
    assert all(b <= a for a, b in pairwise(agreed))


def test_what_was_agreed_on_is_forgotten_over_a_silence() -> None:
    lane = LanePersistence(PersistenceSection())
    for n in range(5):
        lane.update(10**18 + n * 10**8, 0.5)
    assert lane.agreed_m == 0.5
    assert lane.update(10**18 + 20 * 10**9, FREE) == FREE


@pytest.mark.parametrize(
    ("could_see", "degraded"),
    [([True] * 4, [True, True, False, False]), ([False, False, True, True, True], [True, True, True, True, False])],
)
def test_after_a_silence_three_scans_that_see_are_needed(could_see: list[bool], degraded: list[bool]) -> None:
    silence = Silence(PersistenceSection())
    assert not silence.ended(10**18)
    assert silence.reason(could_see=True) == ""
    back_ns = 10**18 + 20 * 10**9
    assert [silence.ended(back_ns + n * 10**8) for n in range(4)] == [True, False, False, False]
    reasons = [silence.reason(saw) for saw in could_see]
    assert [bool(reason) for reason in reasons] == degraded
    assert reasons[0] == "no scan for 20.0 s: looking again"


@pytest.mark.parametrize("gap_s", [0.1, 0.4, 0.5])
def test_slow_scans_are_no_silence(gap_s: float) -> None:
    silence = Silence(PersistenceSection())
    assert not any(silence.ended(10**18 + round(n * gap_s * 1e9)) for n in range(5))


def test_a_time_that_goes_back_is_told_as_such() -> None:
    silence = Silence(PersistenceSection())
    assert not silence.ended(10**9)
    assert silence.ended(10**9 - 12_000_000)
    assert silence.reason(could_see=False) == "the scans' time went back by 0.012 s: looking again"
