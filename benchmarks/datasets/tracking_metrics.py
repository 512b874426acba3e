"""CLEAR-MOT (Bernardin & Stiefelhagen 2008) and IDF1 (Ristani et al. 2016) by distance on the ground, own code."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist


@dataclass
class TrackingScore:
    """Feed frames in order; the figures are totals so far."""

    truths: int = 0
    misses: int = 0
    false: int = 0
    switches: int = 0
    tracks_shown: int = 0
    overlaps: Counter[tuple[int, int]] = field(default_factory=Counter)  # (truth, track) -> frames together
    pairs: list[tuple[int, int, int]] = field(default_factory=list)  # (frame, truth, track) of every match
    _last: dict[int, int] = field(default_factory=dict)
    _frames: int = 0

    def add(
        self, truth_id: np.ndarray, truth_xy: np.ndarray, reach_m: np.ndarray, ignored: np.ndarray,
        track_id: np.ndarray, track_xy: np.ndarray,
    ) -> None:  # fmt: skip
        """One frame: g truths, each found by a track within its ``reach_m``; ``ignored`` ones need not be found."""
        distance = cdist(truth_xy.reshape(-1, 2), track_xy.reshape(-1, 2))
        allowed = distance <= reach_m[:, None]
        partner = self._keep_last(truth_id, track_id, allowed)
        free_g = [g for g in range(len(truth_id)) if g not in partner]
        free_t = [t for t in range(len(track_id)) if t not in partner.values()]
        cost = np.where(allowed, distance, 1e6)[np.ix_(free_g, free_t)]
        for row, column in zip(*linear_sum_assignment(cost), strict=True):
            if cost[row, column] < 1e6:
                partner[free_g[row]] = free_t[column]
        self._count(truth_id, ignored, track_id, partner)
        for g, t in zip(*np.nonzero(allowed), strict=True):
            if not ignored[g]:
                self.overlaps[int(truth_id[g]), int(track_id[t])] += 1

    def _keep_last(self, truth_id: np.ndarray, track_id: np.ndarray, allowed: np.ndarray) -> dict[int, int]:
        where = {int(track): t for t, track in enumerate(track_id)}
        partner: dict[int, int] = {}
        for g, truth in enumerate(truth_id):
            t = where.get(self._last.get(int(truth), -1))
            if t is not None and allowed[g, t] and t not in partner.values():
                partner[g] = t
        return partner

    def _count(self, truth_id: np.ndarray, ignored: np.ndarray, track_id: np.ndarray, partner: dict[int, int]) -> None:
        counted = int(np.sum(~ignored))
        hits = [g for g in partner if not ignored[g]]
        lost_to_ignored = len(partner) - len(hits)
        self.truths += counted
        self.misses += counted - len(hits)
        self.false += len(track_id) - len(partner)
        self.tracks_shown += len(track_id) - lost_to_ignored
        for g, t in partner.items():
            truth, track = int(truth_id[g]), int(track_id[t])
            if not ignored[g]:
                self.switches += self._last.get(truth, track) != track
                self.pairs.append((self._frames, truth, track))
            self._last[truth] = track
        self._frames += 1

    @property
    def mota(self) -> float:
        """1 - (misses + false + switches) / truths."""
        return 1.0 - (self.misses + self.false + self.switches) / max(self.truths, 1)

    @property
    def idf1(self) -> float:
        """Of the one-to-one naming of truths by tracks that explains most frames."""
        rows = sorted({truth for truth, _ in self.overlaps})
        columns = sorted({track for _, track in self.overlaps})
        together = np.zeros((len(rows), len(columns)))
        for (truth, track), frames in self.overlaps.items():
            together[rows.index(truth), columns.index(track)] = frames
        named = together[linear_sum_assignment(-together)].sum()
        return float(2 * named / max(self.truths + self.tracks_shown, 1))
