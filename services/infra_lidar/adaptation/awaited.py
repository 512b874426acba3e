"""Reads a source in a thread; stops when no frame comes within a time-out."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Iterator
from typing import NamedTuple, TypeVar

from common.bus.status import Report

log = logging.getLogger(__name__)

T = TypeVar("T")

PATIENCE_S = 20.0  # time-out: without a frame for this long the source counts as silent


class _End(NamedTuple):
    error: Exception | None


def awaited(frames: Iterator[T], report: Report, patience_s: float = PATIENCE_S) -> Iterator[T]:
    """The frames, read in a separate thread; ends when no frame comes for ``patience_s``.

    report: the status that the source reports.

    Raises:
        ValueError: no frame came at all; the text is the reason that the source reported.
        Exception: an error of the source is raised again.
    """
    arrived: queue.Queue[T | _End] = queue.Queue(1)  # a file is read only as fast as its frames are consumed

    def read() -> None:
        error: Exception | None = None
        try:
            for frame in frames:
                arrived.put(frame)
        except Exception as raised:  # noqa: BLE001  raised again in the thread that consumes the frames
            error = raised
        arrived.put(_End(error))

    threading.Thread(target=read, name="frames", daemon=True).start()
    count = 0
    while True:
        try:
            item = arrived.get(timeout=patience_s)
        except queue.Empty:
            why = f"no frame came for {patience_s:g} s"
            if report.snapshot().state == "disconnected":
                why = report.snapshot().reason
            if not count:
                raise ValueError(why) from None
            log.warning("%s: going on with the %d frames before", why, count)
            return
        if isinstance(item, _End):
            if item.error is not None:
                raise item.error
            return
        count += 1
        yield item
