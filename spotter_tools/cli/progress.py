"""Progress of a long command: a line on a terminal that is overwritten; nothing into a file or a pipe."""

from __future__ import annotations

import sys
from typing import TextIO

from common.clock import monotonic_s
from common.periodic import Periodic

PERIOD_S = 0.2


class Progress:
    """``show`` may be called at any rate: the line is refreshed five times a second."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._shown = self._stream.isatty()
        self._refresh = Periodic(PERIOD_S)
        self._width = 0

    def show(self, text: str) -> None:
        """Show a line, unless the last one is too recent."""
        if self._shown and self._refresh.due(monotonic_s()):
            self._write(text)

    def share(self, done: float, of: float, words: str = "") -> None:
        """A bar for work whose size is known; only the words (or what is done) where it is not: ``of`` 0."""
        if of <= 0:
            self.show(words or f"{done:.0f}")
            return
        part = min(max(done / of, 0.0), 1.0)
        self.show(f"[{'#' * round(30 * part):<30}] {part:4.0%}  {words}")

    def close(self) -> None:
        """Wipe the line."""
        if self._width:
            self._write("")
            self._stream.write("\r")
            self._stream.flush()

    def _write(self, text: str) -> None:
        self._stream.write("\r  " + text.ljust(self._width))
        self._stream.flush()
        self._width = max(self._width, len(text))
