"""The seam between driver and hardware: a few calls, the same for the DreamHAT+ and for the emulated chip."""

from __future__ import annotations

import time
from typing import Protocol

from common import clock


class Clock(Protocol):
    """Time as the driver sees it; tests run it by hand."""

    def monotonic_s(self) -> float:
        """Seconds that never go back."""

    def utc_ns(self) -> int:
        """UTC nanoseconds."""

    def sleep(self, seconds: float) -> None:
        """Wait; not at all for less than 0."""


class SystemClock:
    """The machine's clocks."""

    def monotonic_s(self) -> float:
        return clock.monotonic_s()

    def utc_ns(self) -> int:
        return clock.utc_ns()

    def sleep(self, seconds: float) -> None:
        time.sleep(max(seconds, 0.0))


class Link(Protocol):
    """SPI, reset line and interrupt line of one chip. All calls come from one thread.

    Raises:
        OSError: the bus or a line is gone.
    """

    max_bytes: int  # of one transfer, command included

    def transfer(self, data: bytes) -> bytes:
        """Send while chip select is low; the reply has the same length."""

    def set_reset(self, *, active: bool) -> None:
        """Drive the reset line; active holds the chip in reset."""

    def wait_irq(self, timeout_s: float) -> bool:
        """Return True as soon as the interrupt line is high, False when the time is over."""

    def close(self) -> None:
        """Release bus and lines."""
