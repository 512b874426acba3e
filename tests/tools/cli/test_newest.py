"""What a slow reader finds in a full queue."""

from __future__ import annotations

import queue

from spotter_tools.cli.newest import keep_newest


def test_a_full_queue_loses_its_oldest_and_takes_the_new_one() -> None:
    arrived: queue.Queue[int] = queue.Queue(3)
    for number in range(5):
        keep_newest(arrived, number)
    assert [arrived.get_nowait() for _ in range(3)] == [2, 3, 4]
