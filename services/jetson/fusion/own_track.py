"""Which of the roadside's tracks is our own vehicle: the one that has always been where we are, and moves as we do.

Position alone does not tell: map and pose are some decimetres wrong, and somebody may stand beside us. So a track is
ourselves while all of this holds: it was never seen farther from our outline than map and pose may be wrong; it has
moved with us for some messages; and no other such track is nearer. Whoever came from elsewhere never is.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

ENOUGH = 5  # messages in which it moved with us; one in which it did not takes back three
MOST = 10
MAX_STRANGERS = 4096


class OwnTrack:
    """Remembers, by track id, who came from elsewhere and who moves with us."""

    def __init__(self) -> None:
        self._strangers: dict[int, None] = {}
        self._with_us: Counter[int] = Counter()

    def reset(self) -> None:
        """The pose was lost: what was seen of the tracks from it is worth nothing."""
        self._strangers.clear()
        self._with_us.clear()

    def find(self, ids: list[int], beside_m: np.ndarray, relative_mps: np.ndarray, own_speed_mps: float) -> int | None:
        """The id of our own track among those of one message; None when none is.

        Args:
            ids: N of the tracks.
            beside_m: (N,) from our outline to the middle of each track, 0 inside it, inf where it is too far to be us.
            relative_mps: (N,) speed relative to ours.
            own_speed_mps: what moves with us differs from our motion by no more than this; inf = our motion is not
                known, so that place alone has to tell.

        Raises:
            ValueError: the three are not equally many.
        """
        rows = list(zip(ids, beside_m.tolist(), relative_mps.tolist(), strict=True))
        for one, gap_m, _ in rows:
            if gap_m == np.inf:
                self._strangers[one] = None
        while len(self._strangers) > MAX_STRANGERS:
            self._strangers.pop(next(iter(self._strangers)))
        near = [row for row in rows if row[0] not in self._strangers]
        self._with_us = Counter({one: self._score(one, speed <= own_speed_mps) for one, _, speed in near})
        enough = ENOUGH if own_speed_mps < np.inf else 1
        likely = [(gap_m, one) for one, gap_m, _ in near if self._with_us[one] >= enough or gap_m == 0.0]
        return min(likely)[1] if likely else None

    def _score(self, one: int, with_us: bool) -> int:
        return min(self._with_us[one] + 1, MOST) if with_us else max(self._with_us[one] - 3, 0)
