"""Due times on a clock that only waiting and working move."""

from __future__ import annotations

import threading
from itertools import islice
from types import SimpleNamespace

import pytest

from common import pacing
from common.pacing import Playback, steady, ticks, wait_until


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0
        self.waited_s: list[float] = []

    def read(self) -> float:
        return self.now_s

    def wait(self, seconds: float) -> bool:
        self.waited_s.append(round(seconds, 6))
        self.now_s += seconds
        return False


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(pacing, "monotonic_s", clock.read)
    monkeypatch.setattr(pacing, "time", SimpleNamespace(sleep=clock.wait))  # other threads sleep on
    return clock


def test_a_moment_is_waited_for_and_one_that_has_passed_is_not(clock: Clock) -> None:
    wait_until(100.5)
    wait_until(100.5)
    wait_until(99.0)
    wait_until(101.0, wait=clock.wait)
    assert clock.waited_s == [0.5, 0.0, 0.0, 0.5]


def test_ticks_begin_now_or_when_they_are_told_to(clock: Clock) -> None:
    assert list(islice(ticks(0.1), 3)) == pytest.approx([100.0, 100.1, 100.2])
    assert list(islice(ticks(0.1, first_s=100.5), 2)) == pytest.approx([100.5, 100.6])
    assert clock.now_s == pytest.approx(100.6)


@pytest.mark.parametrize(
    ("busy_s", "next_due_s", "skipped"),
    [(0.05, 100.1, []), (0.15, 100.1, []), (0.25, 100.2, [1]), (1.05, 101.0, [9])],
)
def test_of_the_ticks_that_were_missed_only_the_newest_comes(
    clock: Clock, busy_s: float, next_due_s: float, skipped: list[int]
) -> None:
    reported: list[int] = []
    times = ticks(0.1, skipped=reported.append)
    next(times)
    clock.now_s += busy_s
    assert next(times) == pytest.approx(next_due_s)
    assert reported == skipped
    clock.now_s = max(clock.now_s, next_due_s)
    assert next(times) == pytest.approx(next_due_s + 0.1), "on the same grid as before"


def test_recorded_gaps_are_played_as_they_were(clock: Clock) -> None:
    playback = Playback()
    assert [playback.next_s(gap_s) for gap_s in (0.0, 0.1, 0.4)] == pytest.approx([100.0, 100.1, 100.5])
    assert clock.waited_s == [0.0, 0.1, 0.4]


def test_a_reader_a_little_late_catches_up_and_one_later_than_a_gap_moves_the_schedule(clock: Clock) -> None:
    playback = Playback()
    playback.next_s(0.1)
    clock.now_s += 0.15
    assert playback.next_s(0.1) == pytest.approx(100.2)
    clock.now_s += 0.25
    assert playback.next_s(0.1) == pytest.approx(100.5)
    assert playback.next_s(0.1) == pytest.approx(100.6)


def test_a_gap_of_zero_never_waits(clock: Clock) -> None:
    playback = Playback()
    for _ in range(3):
        assert playback.next_s(0.0) == clock.now_s
        clock.now_s += 0.5
    assert clock.waited_s == [0.0, 0.0, 0.0]


def test_time_lost_by_a_slow_step_is_not_caught_up(clock: Clock) -> None:
    stop = SimpleNamespace(wait=clock.wait, is_set=lambda: False)
    turns = steady(0.1, stop)  # type: ignore[arg-type]
    for step_s in (0.0, 0.0, 0.5, 0.0):
        next(turns)
        clock.now_s += step_s
    next(turns)
    assert clock.waited_s == [0.0, 0.1, 0.1, 0.0, 0.1]


def test_a_stop_ends_the_turns_without_waiting_for_the_next() -> None:
    stop = threading.Event()
    turns = steady(1000.0, stop)
    next(turns)
    stop.set()
    assert next(turns, None) is None
