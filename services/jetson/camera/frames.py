"""A picture on its way through the service, and the hand-over from capture to processing: the newest one wins."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import NamedTuple

import cv2
import numpy as np

from common.bus.status import Report
from common.messages import Motion


class Frame(NamedTuple):
    """One picture and when it was taken."""

    stamp_ns: int  # UTC ns: when the picture was taken, as nearly as the source can tell
    received_ns: int  # UTC ns: when it was complete in this process
    image: np.ndarray  # (H, W, 3) uint8 BGR
    motion: Motion | None = None  # of a recording of the bus: how the vehicle was known to move


Source = Callable[[threading.Event], Iterator[Frame]]  # runs until it ends or the event is set


class NewestFrames:
    """Runs a source in a thread of its own, so that inference never blocks capture; a slow reader skips pictures.

    ``lossless`` makes the source wait for the reader instead: for recordings that are to be evaluated in full.
    """

    def __init__(self, source: Source, report: Report, lossless: bool = False) -> None:
        self._source = source
        self._report = report
        self._lossless = lossless
        self._stop = threading.Event()
        self._changed = threading.Condition()
        self._newest: Frame | None = None
        self._ended = False
        self._error: Exception | None = RuntimeError("the capture thread has died; its traceback was logged")
        self._thread = threading.Thread(target=self._capture, name="capture", daemon=True)

    def __enter__(self) -> NewestFrames:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stop.set()
        with self._changed:
            self._changed.notify_all()
        self._thread.join(1.0)

    def __iter__(self) -> Iterator[Frame]:
        """Frames until the source ends; what broke the source is raised here."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._newest is not None or self._ended)
                frame, self._newest = self._newest, None
                self._changed.notify_all()
            if frame is not None:
                yield frame
            elif self._error is not None:
                raise self._error
            else:
                return

    def _capture(self) -> None:
        try:
            for frame in self._source(self._stop):
                self._put(frame)
                if self._stop.is_set():
                    break
            self._error = None
        except (OSError, ValueError, cv2.error) as error:
            self._error = error  # raised again in the reader's thread
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _put(self, frame: Frame) -> None:
        with self._changed:
            if self._lossless:
                self._changed.wait_for(lambda: self._newest is None or self._stop.is_set())
            if self._newest is not None:
                self._report.dropped()
            self._newest = frame
            self._changed.notify_all()


class RateLimit:
    """Lets through at most ``rate_hz`` stamps a second; a clock that steps back lets the next one through."""

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = round(1e9 / rate_hz)
        self._last_ns: int | None = None

    def __call__(self, stamp_ns: int) -> bool:
        if self._last_ns is not None and 0 <= stamp_ns - self._last_ns < self._period_ns:
            return False
        self._last_ns = stamp_ns
        return True
