"""Which boxes were there a moment before as well: a network's box in one picture alone is often nothing.

Asked only while the vehicle drives. There a first picture costs a fifteenth of a second, and every box of nothing costs
a stop.
"""

from __future__ import annotations

from collections import deque

import numpy as np

PICTURES = 2  # so many of the pictures before are looked at: a network misses one now and then
RECENT_S = 0.25  # and none that is older
TALLER = 1.6  # between two pictures a box grows by less


class Repeats:
    """Remembers the boxes of the last pictures. ``seen_before`` once per picture."""

    def __init__(self) -> None:
        self._before: deque[tuple[int, np.ndarray]] = deque(maxlen=PICTURES)

    def seen_before(self, stamp_ns: int, boxes: np.ndarray) -> np.ndarray:
        """(N,) bool. All are, when no picture before is recent enough to tell.

        Args:
            stamp_ns: UTC nanoseconds of the picture.
            boxes: (N, 4) left, top, right, bottom in pixels.
        """
        recent = [earlier for at_ns, earlier in self._before if 0 < stamp_ns - at_ns <= RECENT_S * 1e9]
        self._before.append((stamp_ns, boxes))
        if not recent:
            return np.ones(len(boxes), bool)
        return np.any([_matched(boxes, earlier) for earlier in recent], axis=0)


def _matched(boxes: np.ndarray, earlier: np.ndarray) -> np.ndarray:
    """(N,) bool: one of the earlier boxes (K, 4) is as tall, and touches the place beside which the box stands."""
    if not len(boxes) or not len(earlier):
        return np.zeros(len(boxes), bool)
    width, height = (boxes[:, 2] - boxes[:, 0])[:, None], (boxes[:, 3] - boxes[:, 1])[:, None]
    ratio = (earlier[:, 3] - earlier[:, 1])[None] / np.maximum(height, 1e-6)
    as_tall = (ratio <= TALLER) & (ratio >= 1.0 / TALLER)
    beside = (earlier[None, :, 0] <= boxes[:, None, 2] + width) & (earlier[None, :, 2] >= boxes[:, None, 0] - width)
    level = (earlier[None, :, 1] <= boxes[:, None, 3]) & (earlier[None, :, 3] >= boxes[:, None, 1])
    return np.asarray((as_tall & beside & level).any(axis=1))
