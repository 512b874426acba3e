"""A queue between the bus and a slow reader: it keeps the newest."""

from __future__ import annotations

import contextlib
import queue
from typing import TypeVar

T = TypeVar("T")


def keep_newest(arrived: queue.Queue[T], one: T) -> None:
    """Put ``one`` without waiting; a full queue loses its oldest. For one writer: a second may take the free place."""
    with contextlib.suppress(queue.Empty):
        if arrived.full():
            arrived.get_nowait()
    with contextlib.suppress(queue.Full):
        arrived.put_nowait(one)
