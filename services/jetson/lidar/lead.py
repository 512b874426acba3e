"""How fast what is ahead in the lane drives away from us: a car that is followed is no wall.

The bands of the lane are for what stands. Somebody who drives ahead leaves his own braking distance free, even if he
brakes as hard as he can, so that much less has to be between us (Shalev-Shwartz, Shammah and Shashua, On a formal model
of safe and scalable self-driving cars, 2017, definition 1). His speed comes from the lane's distances over the last
scans: a straight line through them. What is no straight line (somebody steps in between, he brakes hard) counts as
standing; one scan may be off, a drop of rain is.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from common.messages import Motion
from common.path import is_driving
from services.jetson.lidar.config import LidarConfig


class Lead:
    """Call ``update`` once per scan."""

    def __init__(self, config: LidarConfig) -> None:
        self._config, self._path = config.lead, config.path
        self._seen: deque[tuple[int, float]] = deque()  # stamp, metres ahead of the bumper

    def update(self, stamp_ns: int, nearest_m: float | None, motion: Motion | None) -> float:
        """The speed over ground, m/s, that what is nearest in the lane has at least; 0 = it stands, or is not known.

        In a curve it is not known: a wall beside a bend keeps its distance too.
        """
        config = self._config
        if motion is None or not is_driving(motion, self._path) or abs(motion.yaw_rate_radps) > config.straight_radps:
            self._seen.clear()
            return 0.0
        if nearest_m is not None:
            self._seen.append((stamp_ns, nearest_m))
        while self._seen and not 0 <= stamp_ns - self._seen[0][0] <= config.window_s * 1e9:
            self._seen.popleft()
        if len(self._seen) < config.scans:
            return 0.0
        t_s = np.array([(at_ns - stamp_ns) * 1e-9 for at_ns, _ in self._seen])
        distance_m = np.array([one for _, one in self._seen])
        for _ in range(2):
            leaving_mps, sigma_mps, off_m = _line(t_s, distance_m, config.sigma_m)
            worst = int(off_m.argmax())
            if off_m[worst] <= 3.0 * config.sigma_m:
                return max(0.0, motion.speed_mps + leaving_mps - 2.0 * sigma_mps)
            t_s, distance_m = np.delete(t_s, worst), np.delete(distance_m, worst)
        return 0.0


def _line(t_s: np.ndarray, distance_m: np.ndarray, sigma_m: float) -> tuple[float, float, np.ndarray]:
    """Slope of the line through the distances by least squares, its standard deviation, how far off (N,) each is."""
    t, d = t_s - t_s.mean(), distance_m - distance_m.mean()
    slope = float(t @ d / (t @ t))
    return slope, sigma_m / float(np.sqrt(t @ t)), np.abs(d - slope * t)
