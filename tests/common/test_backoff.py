"""The pauses of an exponential back-off."""

from __future__ import annotations

from common.backoff import Backoff


def test_the_pause_doubles_up_to_the_longest() -> None:
    backoff = Backoff(0.2, 1.0)
    assert [backoff.next_s() for _ in range(5)] == [0.2, 0.4, 0.8, 1.0, 1.0]


def test_after_a_reset_it_begins_again() -> None:
    backoff = Backoff(0.5, 4.0)
    for _ in range(3):
        backoff.next_s()
    backoff.reset()
    assert [backoff.next_s(), backoff.next_s()] == [0.5, 1.0]
