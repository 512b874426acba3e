"""When a sensor is better again, frame by frame: a few good ones, many while its faults come and go."""

from __future__ import annotations

from typing import Any

import pytest

from services.jetson.fusion.config import HealthConfig
from services.jetson.fusion.recovery import RANK_OF_STATE, RESUME_GRACE_S, Habit, Recovery

CONFIG = HealthConfig(recovery_frames=3, flicker_frames=20, flicker_s=4.0)


def recovery(*frames: tuple[float, Any]) -> Recovery:
    """After these frames: when, and what was wrong with it."""
    one = Recovery(CONFIG)
    for now_s, state in frames:
        one.note_frame(now_s, state)
    return one


def good(one: Recovery, count: int, now_s: float = 10.0) -> Recovery:
    for _ in range(count):
        one.note_frame(now_s, "online")
    return one


@pytest.mark.parametrize(
    ("was", "state", "frames"),
    [
        ("disconnected", "online", 3),
        ("degraded", "online", 3),
        ("disconnected", "degraded", 3),
        ("online", "online", 0),
        ("online", "degraded", 0),
        ("online", "disconnected", 0),
        ("degraded", "degraded", 0),
        ("degraded", "disconnected", 0),
        ("disconnected", "disconnected", 0),
    ],
)
def test_only_better_takes_frames_and_so_many(was: Any, state: Any, frames: int) -> None:
    for count in range(5):
        lacks = good(Recovery(CONFIG), count).lacks(10.0, was, state)
        assert lacks == ("" if count >= frames else f"recovering, {count} of 3 good frames")


def test_a_first_frame_at_the_clock_s_beginning_counts() -> None:
    assert recovery((0.0, "degraded")).habit("degraded", reported=True).faults_s == (0.0,)
    assert Habit("online", reported=True) == Habit("online", True, 0, 0, ())


def test_the_states_have_an_order() -> None:
    assert sorted(RANK_OF_STATE, key=RANK_OF_STATE.__getitem__) == ["online", "degraded", "disconnected"]


def test_an_impaired_frame_came_in_time_and_is_not_good() -> None:
    one = recovery((1.0, "online"), (1.1, "online"), (1.2, "degraded"))
    assert (one.good_frames, one.fresh_frames) == (0, 3)
    one.note_frame(1.3, "disconnected")
    assert (one.good_frames, one.fresh_frames) == (0, 0)
    one.note_frame(1.4, "online")
    assert (one.good_frames, one.fresh_frames) == (1, 1)


def test_a_fault_without_a_frame_interrupts_both_rows_or_one() -> None:
    one = good(Recovery(CONFIG), 5)
    one.note_fault(10.1, "degraded", reported=True)
    assert (one.good_frames, one.fresh_frames) == (0, 5)
    one.note_fault(10.2, "disconnected", reported=False)
    assert (one.good_frames, one.fresh_frames) == (0, 0)


@pytest.mark.parametrize(("between_s", "needed"), [(3.9, 20), (4.0, 20), (4.1, 3)])
def test_two_faults_that_began_within_the_time_are_flicker(between_s: float, needed: int) -> None:
    """Judged at the moment of the second: how long ago the first began."""
    one = recovery((10.0, "degraded"), (10.1, "online"), (10.0 + between_s, "degraded"))
    assert one.lacks(10.0 + between_s, "degraded", "online") == f"recovering, 0 of {needed} good frames"


def test_one_long_fault_is_none() -> None:
    one = recovery((10.0, "degraded"), (10.1, "degraded"), (10.2, "degraded"))
    assert one.lacks(10.2, "degraded", "online").endswith("of 3 good frames")
    one.note_fault(10.3, "disconnected", reported=True)
    assert one.lacks(10.3, "disconnected", "online").endswith("of 3 good frames"), "the same fault goes on"


def test_a_flickering_sensor_needs_many_and_then_it_is_forgiven() -> None:
    one = recovery((10.0, "degraded"), (10.1, "online"), (10.2, "degraded"))
    assert good(one, 19).lacks(12.0, "degraded", "online") == "recovering, 19 of 20 good frames"
    assert good(one, 1).lacks(12.0, "degraded", "online") == ""
    assert good(recovery((10.0, "degraded"), (10.1, "online"), (10.2, "degraded")), 3).lacks(
        14.1, "degraded", "online"
    ) == "", "the first fault is too long ago"  # fmt: skip


def test_silence_before_the_first_message_is_start_up_and_no_fault() -> None:
    for reported, needed in ((False, 3), (True, 20)):
        one = Recovery(CONFIG)
        one.note_fault(9.0, "disconnected", reported=reported)
        good(one, 1, 9.5)
        one.note_fault(9.6, "disconnected", reported=reported)
        assert one.lacks(9.7, "disconnected", "online") == f"recovering, 0 of {needed} good frames"


FLICKERED = Habit("online", reported=True, good_frames=7, fresh_frames=9, faults_s=(8.0, 9.0))
OUT = Habit("degraded", reported=True, good_frames=0, fresh_frames=2, faults_s=(8.0, 9.0))


def resumed(habit: Habit) -> Recovery:
    one = Recovery(CONFIG)
    one.resume(10.0, habit)
    return one


@pytest.mark.parametrize("habit", [FLICKERED, OUT])
def test_a_successor_knows_what_its_predecessor_knew(habit: Habit) -> None:
    one = resumed(habit)
    assert (one.good_frames, one.fresh_frames) == (habit.good_frames, habit.fresh_frames)
    assert one.habit("disconnected", reported=True) == habit, "our own start is no change of it"
    one.judged(habit.state)
    assert one.habit("disconnected", reported=False).state == "disconnected", "from here on it is judged"


def test_a_first_process_writes_the_state_that_it_judges() -> None:
    one = recovery((1.0, "degraded"), (1.1, "online"))
    assert one.habit("degraded", reported=True) == Habit("degraded", True, 1, 2, (1.0,))
    assert not one.habit("online", reported=False).reported


def test_back_to_what_it_was_takes_few_frames_after_a_restart_and_no_better() -> None:
    """The habit flickers; what it was already earned before the restart it need not earn again."""
    assert resumed(replace_good(FLICKERED)).lacks(10.5, "disconnected", "online").endswith("0 of 3 good frames")
    one = resumed(OUT)
    assert one.lacks(10.5, "disconnected", "degraded") == "recovering, 2 of 3 good frames"
    assert one.lacks(10.5, "degraded", "online") == "recovering, 0 of 20 good frames"


def replace_good(habit: Habit) -> Habit:
    return Habit(habit.state, habit.reported, 0, 0, habit.faults_s)


@pytest.mark.parametrize(("judged", "over"), [("online", True), ("degraded", True), ("disconnected", False)])
def test_the_restart_is_over_when_it_is_there_again_or_better(judged: Any, over: bool) -> None:
    one = resumed(OUT)
    one.judged(judged)
    assert (one.habit("disconnected", reported=True).state == "disconnected") == over


@pytest.mark.parametrize(("after_s", "counts"), [(0.0, False), (RESUME_GRACE_S - 0.01, False), (RESUME_GRACE_S, True)])
def test_what_seems_wrong_right_after_a_restart_is_no_fault(after_s: float, counts: bool) -> None:
    assert RESUME_GRACE_S == 1.0
    for note in (
        lambda one: one.note_frame(10.0 + after_s, "degraded"),
        lambda one: one.note_fault(10.0 + after_s, "degraded", reported=True),
    ):
        one = resumed(FLICKERED)
        note(one)
        assert one.habit("degraded", reported=True).faults_s == ((9.0, 10.0 + after_s) if counts else (8.0, 9.0))


def test_a_fault_within_the_grace_interrupts_no_row() -> None:
    one = resumed(FLICKERED)
    one.note_fault(10.5, "disconnected", reported=True)
    assert (one.good_frames, one.fresh_frames) == (7, 9)
    one.note_fault(11.0, "disconnected", reported=True)
    assert (one.good_frames, one.fresh_frames) == (0, 0)


def test_what_was_out_before_the_restart_has_no_new_fault_by_being_out() -> None:
    one = resumed(OUT)
    one.note_frame(12.0, "degraded")
    assert one.habit("degraded", reported=True).faults_s == (8.0, 9.0)
    one = resumed(FLICKERED)
    one.note_frame(12.0, "degraded")
    assert one.habit("degraded", reported=True).faults_s == (9.0, 12.0)


@pytest.mark.parametrize(
    ("state", "reported", "then"),
    [("disconnected", True, "disconnected"), ("degraded", True, "degraded"), ("disconnected", False, "degraded")],
)
def test_one_that_gets_worse_after_the_restart_does_so_by_itself(state: Any, reported: bool, then: str) -> None:
    one = resumed(OUT)
    one.note_fault(11.5, state, reported=reported)
    assert one.habit("online", reported=True).state == then
