"""How long each stage of a pipeline took: for ``stage_ms`` only, no decision depends on it."""

from __future__ import annotations

from time import perf_counter


class Stopwatch:
    """``lap(name)`` books the time since the last lap under ``name``."""

    def __init__(self) -> None:
        self.stage_ms: dict[str, float] = {}
        self._last_s = perf_counter()

    def lap(self, name: str) -> None:
        """Book the time since the last lap under ``name``."""
        now_s = perf_counter()
        self.stage_ms[name] = (now_s - self._last_s) * 1e3
        self._last_s = now_s
