"""A gyroscope's raw rate to a yaw rate: bias learned at standstill. Pure."""

from __future__ import annotations

import math

UNKNOWN_BIAS_RADPS = 0.1  # the data sheets' zero-rate level, up to 20 degrees per second; usual is a fifth of it
LEARN_S = 1.0  # of standing still
CALM_RADPS = 0.03  # the spread of a vehicle that stands still
MEMORY = 0.02  # how fast the bias follows afterwards, per sample


class GyroBias:
    """Learns the bias while the vehicle stands: measured at zero speed, or, while nobody measures it, calm."""

    def __init__(self) -> None:
        self.bias_radps: float | None = None
        self._samples: list[float] = []
        self._since_s: float | None = None

    def correct(self, at_s: float, raw_radps: float, *, standing: bool | None) -> tuple[float, float]:
        """(yaw rate, standard deviation) in rad/s; ``standing`` None = nobody measures the speed."""
        if standing is False:
            self._forget()
        else:
            self._learn(at_s, raw_radps, known=standing is True)
        if self.bias_radps is None:
            return raw_radps, UNKNOWN_BIAS_RADPS
        return raw_radps - self.bias_radps, 0.01

    def _learn(self, at_s: float, raw_radps: float, *, known: bool) -> None:
        self._samples.append(raw_radps)
        self._since_s = at_s if self._since_s is None else self._since_s
        if self.bias_radps is not None and known:
            self.bias_radps += MEMORY * (raw_radps - self.bias_radps)
        if at_s - self._since_s < LEARN_S:
            return
        mean = math.fsum(self._samples) / len(self._samples)
        most_radps = 4 * UNKNOWN_BIAS_RADPS if known else UNKNOWN_BIAS_RADPS  # else it may be a long curve
        calm = max(self._samples) - min(self._samples) < 2 * CALM_RADPS and abs(mean) < most_radps
        if calm and self.bias_radps is None:
            self.bias_radps = mean
        self._forget()

    def _forget(self) -> None:
        self._samples, self._since_s = [], None
