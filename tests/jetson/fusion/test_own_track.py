"""Ourselves among the roadside's tracks: by place and motion, never somebody who came from elsewhere."""

from __future__ import annotations

import math

import numpy as np
import pytest

from services.jetson.fusion.own_track import ENOUGH, MAX_STRANGERS, OwnTrack


def look(own: OwnTrack, *rows: tuple[int, float, float]) -> int | None:
    """One message: (id, metres beside us or inf, relative speed) of every track."""
    ids = [row[0] for row in rows]
    return own.find(ids, np.array([row[1] for row in rows]), np.array([row[2] for row in rows]), 0.5)


def test_what_moves_with_us_close_by_for_some_messages_is_us() -> None:
    own = OwnTrack()
    ids = [look(own, (7, 0.45, 0.1)) for _ in range(ENOUGH)]
    assert ids == [None] * (ENOUGH - 1) + [7]
    assert look(own, (7, 0.45, 0.5)) == 7, "exactly as different as allowed"


def test_a_track_on_our_own_place_is_us_at_once() -> None:
    assert look(OwnTrack(), (7, 0.0, 2.0)) == 7
    assert look(OwnTrack()) is None


def test_one_odd_message_changes_nothing_two_do() -> None:
    own = OwnTrack()
    for _ in range(20):
        look(own, (7, 0.45, 0.1))
    assert look(own, (7, 0.45, 0.6)) == 7
    assert look(own, (7, 0.45, 0.6)) is None
    assert look(own, (7, 0.45, 0.1)) == 7


def test_one_odd_message_takes_back_three_and_not_less_than_none() -> None:
    own = OwnTrack()
    for _ in range(ENOUGH + 1):
        look(own, (7, 0.45, 0.1))
    look(own, (7, 0.45, 0.6))
    assert [look(own, (7, 0.45, 0.1)) for _ in range(2)] == [None, 7]
    for _ in range(20):
        look(own, (7, 0.45, 0.6))
    assert [look(own, (7, 0.45, 0.1)) for _ in range(ENOUGH)] == [None] * (ENOUGH - 1) + [7]


def test_whoever_came_from_elsewhere_never_is() -> None:
    own = OwnTrack()
    look(own, (8, math.inf, 1.0))
    for beside_m in (0.4, 0.0):
        assert [look(own, (8, beside_m, 0.0)) for _ in range(20)] == [None] * 20


def test_what_moves_otherwise_than_we_do_is_not() -> None:
    own = OwnTrack()
    assert [look(own, (7, 0.45, 0.51)) for _ in range(20)] == [None] * 20


def test_while_our_motion_is_unknown_place_alone_tells() -> None:
    own = OwnTrack()
    assert own.find([7], np.array([0.45]), np.array([5.0]), math.inf) == 7
    assert own.find([7, 8], np.array([math.inf, 0.3]), np.array([5.0, 5.0]), math.inf) == 8
    assert own.find([7], np.array([0.3]), np.array([5.0]), math.inf) is None


@pytest.mark.parametrize("order", [(7, 9), (9, 7)])
def test_the_nearer_of_two_is_us(order: tuple[int, int]) -> None:
    own, beside_m = OwnTrack(), {7: 0.2, 9: 0.5}
    ids = [look(own, *((one, beside_m[one], 0.1) for one in order)) for _ in range(ENOUGH)]
    assert ids[-1] == 7


def test_a_track_that_was_lost_begins_anew() -> None:
    own = OwnTrack()
    for _ in range(ENOUGH):
        look(own, (7, 0.45, 0.1))
    assert look(own) is None
    assert look(own, (7, 0.45, 0.1)) is None


def test_the_oldest_of_very_many_strangers_is_forgotten_first() -> None:
    own = OwnTrack()
    look(own, *((one, math.inf, 1.0) for one in range(MAX_STRANGERS)))
    assert look(own, (0, 0.0, 0.0)) is None
    look(own, (MAX_STRANGERS, math.inf, 1.0))
    assert look(own, (0, 0.0, 0.0)) == 0
    assert look(own, (1, 0.0, 0.0)) is None


def test_a_row_without_its_place_is_refused() -> None:
    with pytest.raises(ValueError, match="shorter"):
        OwnTrack().find([7, 8], np.array([0.0]), np.array([0.0, 0.0]), 0.5)


def test_a_lost_pose_forgets_everybody_and_strangers_do_not_pile_up() -> None:
    own = OwnTrack()
    for first in range(0, 3 * MAX_STRANGERS, 100):
        look(own, *((first + one, math.inf, 1.0) for one in range(100)))
    assert look(own, (3 * MAX_STRANGERS - 1, 0.0, 0.0)) is None
    own.reset()
    assert look(own, (3 * MAX_STRANGERS - 1, 0.0, 0.0)) is not None
