"""Can the sensor see? Judged over many scans, by what became of the beams in the forward cone.

An empty road and a blocked lens both show nothing in the lanes. What tells them apart is how the beams end: a return
at any range up to 12 m means that the sensor can see; beams that end at the lens, come back without a distance or
hardly come back at all are evidence of the opposite, and go into the reason.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from services.jetson.lidar.config import FilterSection, HealthSection
from services.jetson.lidar.filters import RejectReason, Returns

REASONS = len(RejectReason)
PASSES_RAD = np.radians(1.2)  # a beam and a half, over two thirds of the scans that are judged together
_CAME_BACK = (RejectReason.USED, RejectReason.ISOLATED, RejectReason.GRAZING)


@dataclass(frozen=True)
class Evidence:
    """How the beams of one or more scans ended. Sectors run from right to left, one more on either side of the cone."""

    fan: np.ndarray  # (sectors + 2, REASONS) int counts
    reach_m: np.ndarray  # (sectors + 2,) sum of the ranges of what returned
    ring: np.ndarray  # (REASONS,) int counts outside the cone
    motor: str  # what the assembler says about the motor; "" = turns
    bearings_rad: tuple[np.ndarray, ...] = ()  # by scan: (K,) of the beams that came back, or ended at the lens

    @property
    def sectors(self) -> np.ndarray:
        """(sectors, REASONS) int counts inside the cone."""
        return self.fan[1:-1]

    @property
    def cone(self) -> np.ndarray:
        """(REASONS,) int counts inside the cone."""
        return np.asarray(self.sectors.sum(axis=0))

    def __add__(self, other: Evidence) -> Evidence:
        return Evidence(
            self.fan + other.fan,
            self.reach_m + other.reach_m,
            self.ring + other.ring,
            self.motor and other.motor,
            self.bearings_rad + other.bearings_rad,
        )


def evidence(returns: Returns, reject_reason: np.ndarray, fov_deg: float, sectors: int, motor: str = "") -> Evidence:
    """Count the beams of one scan by sector of the cone and by reject reason."""
    half_rad = np.radians(fov_deg / 2) + 1e-6
    sector = np.floor((returns.angle_rad + half_rad) / (2 * half_rad) * sectors).astype(np.int64) + 1
    ring = (sector < 1) | (sector > sectors)
    near = (sector >= 0) & (sector <= sectors + 1)
    counts = np.bincount(sector[near] * REASONS + reject_reason[near], minlength=(sectors + 2) * REASONS)
    came_back = near & np.isin(reject_reason, _CAME_BACK)
    reach_m = np.bincount(sector[came_back], weights=returns.range_m[came_back], minlength=sectors + 2)
    lit_rad = returns.angle_rad[reject_reason != RejectReason.NO_ECHO]
    ring_counts = np.bincount(reject_reason[ring], minlength=REASONS)
    return Evidence(counts.reshape(-1, REASONS), reach_m, ring_counts, motor, (lit_rad,))


def looked(seen: Evidence, returns: Returns, fov_deg: float, config: HealthSection) -> bool:
    """Enough of the cone was measured, and most of it was not stopped at the lens."""
    measured = int(seen.cone.sum())
    expected = np.radians(fov_deg) / returns.step_rad
    obstructed = seen.cone[[RejectReason.NEAR, RejectReason.ECHO_ONLY, RejectReason.WEAK]].sum()
    share = config.observed_share
    return bool(measured >= share * expected and obstructed <= share * measured)


def could_see(seen: Evidence, returns: Returns, fov_deg: float, config: HealthSection) -> bool:
    """Would this scan have shown an obstacle? Only then may it count towards lowering an alarm: something came back
    as well, since nothing at all may be a black cover."""
    return looked(seen, returns, fov_deg, config) and _returned(seen.cone) > 0


def covered_by_something_near(seen: Evidence, config: HealthSection) -> bool:
    """Most of the cone ends at a measured distance below the floor: a thing that has come that near is not gone."""
    return bool(seen.cone[RejectReason.NEAR] > config.observed_share * seen.cone.sum())


class HealthMonitor:
    """Degraded after 15 bad scans (or 1.5 s of them), well again after 3 good ones.

    Bad is judged on the summed evidence of those scans, so that rain, which hits other beams each turn, is seen as
    well as tape, which always covers the same; the oldest of them has to be bad by itself, so that a heavy fault does
    not count as a long one. Each of the good scans has to be good by itself.
    """

    def __init__(self, config: HealthSection, filters: FilterSection, fov_deg: float) -> None:
        self._config, self._filters, self._fov_deg = config, filters, fov_deg
        self._history: deque[tuple[int, Evidence]] = deque(maxlen=max(config.scans, config.good_scans))
        self.reason = ""
        self.open_ahead = False  # nothing comes back from ahead, and what borders that moves: it is no cover

    def update(self, stamp_ns: int, seen: Evidence) -> str:
        """Why the sensor cannot see, "" when it can."""
        self._history.append((stamp_ns, seen))
        if self.reason and self._healed():
            self.reason = ""
            self._history.clear()
        window = self._window(stamp_ns)
        self.open_ahead = False
        if window and self._diagnose(window[:1]):
            self.reason = self._diagnose(window) or self.reason
            half_rad = np.radians(self._fov_deg / 2)
            self.open_ahead = not self.reason and moves_apart(
                sum(window[1:], window[0]).bearings_rad, -half_rad, half_rad
            )
        return self.reason

    def _healed(self) -> bool:
        recent = [seen for _, seen in self._history][-self._config.good_scans :]
        return len(recent) == self._config.good_scans and not any(self._diagnose([one]) for one in recent)

    def _window(self, now_ns: int) -> list[Evidence]:
        """The newest 15 scans, or fewer (but three) that took 1.5 s; empty when there are not enough."""
        chosen: list[Evidence] = []
        for stamp_ns, seen in reversed(self._history):
            chosen.insert(0, seen)
            long_enough = len(chosen) >= 3 and now_ns - stamp_ns >= self._config.seconds * 1e9
            if len(chosen) == self._config.scans or long_enough:
                return chosen
        return []

    def _diagnose(self, scans: list[Evidence]) -> str:
        total = sum(scans[1:], scans[0])
        return total.motor or diagnose(total, len(scans), self._config, self._filters, self._fov_deg)


def diagnose(total: Evidence, scans: int, config: HealthSection, filters: FilterSection, fov_deg: float) -> str:
    """The most serious thing wrong with the summed evidence of some scans, as a sentence; "" = nothing."""
    cone = total.cone
    measured = int(cone.sum())
    if measured == 0:
        return f"no measurement in the forward cone for {scans} scans: packets are lost"
    # A lone return now and then is a ghost; one in every fifth scan is a thin pole that the sensor does see.
    if cone[RejectReason.USED] == 0 and _returned(cone) < max(1.0, 0.2 * scans):
        half_rad = np.radians(fov_deg / 2)
        lens = int(cone[[RejectReason.NEAR, RejectReason.ECHO_ONLY, RejectReason.WEAK]].sum())
        if not lens and moves_apart(total.bearings_rad, -half_rad, half_rad):
            return ""
        return _blind(cone, total.ring, scans, config, filters)
    return _sectors(total, scans, config, fov_deg) or _dirty(cone, measured, scans, config, filters)


def _blind(cone: np.ndarray, ring: np.ndarray, scans: int, config: HealthSection, filters: FilterSection) -> str:
    """No return at any range: say what the beams did instead."""
    measured = int(cone.sum())
    enough = config.blind_share * measured
    if cone[RejectReason.NEAR] >= enough:
        return (
            f"lens blocked: {_share(cone[RejectReason.NEAR], measured)} of the forward beams end nearer than "
            f"{filters.min_range_m:.2f} m, none farther ({scans} scans)"
        )
    if cone[RejectReason.ECHO_ONLY] >= enough:
        return (
            f"lens covered: {_share(cone[RejectReason.ECHO_ONLY], measured)} of the forward beams come back "
            f"bright but without a distance ({scans} scans)"
        )
    if cone[RejectReason.WEAK] >= enough:
        return (
            f"low confidence: {_share(cone[RejectReason.WEAK], measured)} of the forward beams come back weaker than "
            f"{filters.min_confidence} ({scans} scans); clean the lens"
        )
    ring_text = f"; of the other beams {_share(_returned(ring), ring.sum())} return" if ring.sum() else ""
    return (
        f"open or covered: no return up to {filters.max_range_m:.0f} m in the forward cone for {scans} scans, "
        f"and no light near the lens{ring_text}"
    )


def _sectors(total: Evidence, scans: int, config: HealthSection, fov_deg: float) -> str:
    """Parts of the cone that see nothing while others do.

    Light that ends at the lens proves a cover. Without light it may be a gap between two things, so the surroundings
    have to speak: nearly every other beam returns, and what flanks the dark part is so near that a gap would be narrow.
    A gap that the vehicle drives at widens; a cover does not.
    """
    width_deg = fov_deg / config.sectors
    closed = _returned(total.ring) >= config.closed_ring_share * max(int(total.ring.sum()), 1)
    for number, counts in enumerate(total.sectors):
        measured = int(counts.sum() - counts[RejectReason.IGNORED])
        if measured == 0 or _returned(counts):
            continue
        lit = int(counts[[RejectReason.NEAR, RejectReason.ECHO_ONLY, RejectReason.WEAK]].sum())
        right_deg = number * width_deg - fov_deg / 2
        where = f"from {right_deg:+.0f} to {right_deg + width_deg:+.0f} deg"
        if lit >= config.sector_share * measured:
            return f"partly blocked {where}: {_share(lit, measured)} of its beams end at the lens ({scans} scans)"
        flank_m = _flank_m(total, number + 1)
        gap = moves_apart(total.bearings_rad, np.radians(right_deg), np.radians(right_deg + width_deg))
        if closed and flank_m <= config.flank_m and not gap:
            return (
                f"partly open or covered {where}: no return in {scans} scans, things on both sides of it within "
                f"{flank_m:.1f} m, and {_share(_returned(total.ring), total.ring.sum())} of the beams around return"
            )
    return ""


def moves_apart(bearings_rad: tuple[np.ndarray, ...], right_rad: float, left_rad: float) -> bool:
    """Whether what borders a dark part on both sides moves away from it, from the first third of the scans to the last.

    The vehicle drives at a gap, and its sides pass: parallax. What is on the lens turns with the lens.

    Args:
        bearings_rad: by scan, of all beams that are not dark.
    """
    third = len(bearings_rad) // 3
    if third == 0:
        return False
    right = [float(one[one < right_rad].max(initial=-np.inf)) for one in bearings_rad]
    left = [float(one[one > left_rad].min(initial=np.inf)) for one in bearings_rad]
    ends = [float(np.median(side[part])) for side in (right, left) for part in (slice(third), slice(-third, None))]
    first_right, last_right, first_left, last_left = ends
    if not np.all(np.isfinite(ends)):
        return False
    return first_right - last_right >= PASSES_RAD and last_left - first_left >= PASSES_RAD


def _flank_m(total: Evidence, place: int) -> float:
    """How far the farther of the two things on either side of a dark sector of the fan is; infinity = open there."""
    came_back = total.fan[:, _CAME_BACK].sum(axis=1)
    lit = np.flatnonzero(came_back)
    right, left = lit[lit < place], lit[lit > place]
    if not len(right) or not len(left):
        return float("inf")
    return max(float(total.reach_m[side] / came_back[side]) for side in (right[-1], left[0]))


def _dirty(cone: np.ndarray, measured: int, scans: int, config: HealthSection, filters: FilterSection) -> str:
    """The sensor sees, but through something."""
    near, scattered, weak = int(cone[RejectReason.NEAR]), int(cone[RejectReason.ISOLATED]), int(cone[RejectReason.WEAK])
    if near >= config.dirt_share * measured:
        return (
            f"rain or dirt near the lens: {_share(near, measured)} of the forward beams end nearer than "
            f"{filters.min_range_m:.2f} m ({scans} scans)"
        )
    if scattered >= config.scatter_share * measured:
        return f"rain or dust: {_share(scattered, measured)} of the forward returns stand alone ({scans} scans)"
    if weak >= config.weak_share * measured:
        return f"low confidence: {_share(weak, measured)} of the forward returns are weak ({scans} scans)"
    return ""


def _returned(counts: np.ndarray) -> int:
    return int(counts[list(_CAME_BACK)].sum())


def _share(part: float, whole: float) -> str:
    return f"{100 * part / max(whole, 1):.0f} %"
