"""Capture and processing side by side: the newest picture wins, nothing is lost that must not be."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np
import pytest

from common.bus.status import Report
from services.jetson.camera.frames import Frame, NewestFrames, RateLimit

IMAGE = np.zeros((2, 2, 3), np.uint8)


def frame(number: int) -> Frame:
    return Frame(number, number, IMAGE)


def test_a_slow_reader_gets_the_newest_and_the_skipped_are_counted(report: Report) -> None:
    all_are_taken = threading.Event()

    def burst(stop: threading.Event) -> Iterator[Frame]:
        for number in range(10):
            yield frame(number)
        all_are_taken.set()

    with NewestFrames(burst, report) as frames:
        assert all_are_taken.wait(30)
        assert [f.stamp_ns for f in frames] == [9]
    assert report.snapshot().dropped == 9


def test_lossless_waits_for_the_reader(report: Report) -> None:
    with NewestFrames(lambda stop: map(frame, range(50)), report, lossless=True) as frames:
        assert [f.stamp_ns for f in frames] == list(range(50))
    assert report.snapshot().dropped == 0


def test_leaving_stops_a_source_that_never_ends(report: Report) -> None:
    ended = threading.Event()

    def endless(stop: threading.Event) -> Iterator[Frame]:
        number = 0
        while not stop.wait(0.001):
            yield frame(number)
            number += 1
        ended.set()

    with NewestFrames(endless, report) as frames:
        assert next(iter(frames)).image is IMAGE
    assert ended.wait(30)


def test_what_breaks_the_source_is_raised_to_the_reader(report: Report) -> None:
    def broken(stop: threading.Event) -> Iterator[Frame]:
        yield frame(1)
        raise OSError("the disk is gone")

    with NewestFrames(broken, report, lossless=True) as frames, pytest.raises(OSError, match="the disk is gone"):
        for _ in frames:
            pass


@pytest.mark.parametrize(
    ("stamps_ms", "through"),
    [
        ([0, 66, 133, 200, 266], [0, 200]),  # 15 Hz in, 5 Hz out
        ([0, 1000, 2000], [0, 1000, 2000]),
        ([5000, 10, 20], [5000, 10]),  # the clock was set back
    ],
)
def test_rate_limit(stamps_ms: list[int], through: list[int]) -> None:
    due = RateLimit(5.0)
    assert [ms for ms in stamps_ms if due(ms * 1_000_000)] == through
