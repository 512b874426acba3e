"""Edges of a wheel encoder to a speed: one channel, or two in quadrature. Pure; times come with the edges."""

from __future__ import annotations

import math
from collections import deque

from services.jetson.ego.config import EncoderConfig

# Level of (a, b) before and after: +1 forward, -1 backward, 0 no change; both at once is an edge that was missed.
_FORWARD = {(0, 0): (1, 0), (1, 0): (1, 1), (1, 1): (0, 1), (0, 1): (0, 0)}
SILENT_CHANNEL_EDGES = 8  # of one channel without one of the other: a broken wire
MAX_EDGES = 512


class WheelEncoder:
    """``edge`` at every edge, ``speed`` whenever it is wanted.

    One channel (``two`` False) counts rising edges and knows no direction: the speed is never negative. Two channels
    count every edge, four for each pulse, and know it. ``pulses_per_m`` are pulses of one channel per metre.
    """

    def __init__(self, config: EncoderConfig, *, two: bool) -> None:
        self._config, self._two = config, two
        self._counts_per_m = config.pulses_per_m * (4 if two else 1)
        self._shortest_s = 0.25 / (self._counts_per_m * config.max_speed_mps)  # nearer edges are contact bounce
        self._edges: deque[tuple[float, int]] = deque(maxlen=MAX_EDGES)  # (monotonic seconds, +1 or -1)
        self._levels = (0, 0)
        self._run = ("", 0)  # the channel of the last edges, and how many of it in a row
        self.bounced = self.missed = 0

    @property
    def silent_channel(self) -> str:
        """The channel from which nothing comes while the other one turns; empty when both do."""
        channel, count = self._run
        broken = self._two and count >= SILENT_CHANNEL_EDGES
        return {"a": "b", "b": "a"}[channel] if broken else ""

    def edge(self, at_s: float, channel: str, *, rising: bool) -> None:
        """An edge of channel "a" or "b" at ``at_s`` (monotonic)."""
        if not self._two:
            if rising:
                self._count(at_s, 1)
            return
        self._run = (channel, self._run[1] + 1 if channel == self._run[0] else 1)
        before = self._levels
        after = (int(rising), before[1]) if channel == "a" else (before[0], int(rising))
        self._levels = after
        if after == before:
            self.missed += 1
        else:
            self._count(at_s, 1 if _FORWARD[before] == after else -1)

    def speed(self, now_s: float) -> tuple[float, float]:
        """(metres per second, standard deviation) at ``now_s``; zero after ``zero_after_s`` without an edge.

        Between edges the speed cannot be more than one count in the time since the last one.
        """
        config = self._config
        if not self._edges or now_s - self._edges[-1][0] >= config.zero_after_s:
            return 0.0, 1.0 / (self._counts_per_m * config.zero_after_s)
        last_s, direction = self._edges[-1]
        begin_s = last_s - config.window_s
        inside = [edge for edge in self._edges if edge[0] >= begin_s]
        if len(inside) < 2:
            inside = list(self._edges)[-2:]
        span_s = last_s - inside[0][0]
        if len(inside) < 2 or span_s <= 0.0 or span_s > config.zero_after_s:
            return self._at_most(now_s, last_s, direction), 1.0 / (self._counts_per_m * config.zero_after_s)
        net = sum(step for _, step in inside[1:])
        speed = net / (self._counts_per_m * span_s)
        bound = 1.0 / (self._counts_per_m * max(now_s - last_s, 1e-6))
        sigma = max(0.29 / (self._counts_per_m * span_s), config.scale_error * abs(speed))  # a count spread evenly
        return math.copysign(min(abs(speed), bound), speed), sigma

    def _at_most(self, now_s: float, last_s: float, direction: int) -> float:
        return direction / (self._counts_per_m * max(now_s - last_s, self._config.zero_after_s))

    def _count(self, at_s: float, step: int) -> None:
        if self._edges and 0.0 <= at_s - self._edges[-1][0] < self._shortest_s:
            self.bounced += 1
            return
        self._edges.append((at_s, step))
