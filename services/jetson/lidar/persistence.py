"""A distance counts when several scans agree on it, and is given up when several agree that it is gone."""

from __future__ import annotations

import math
from collections import deque

from services.jetson.lidar.config import PersistenceSection


class LanePersistence:
    """Holds one lane's *agreed* distance (infinity = nothing there).

    Nearer: something was at least that near in each of the last 3 scans, so the largest of 3. Farther: nothing was
    nearer in any of the last 4, so the smallest of 4. For every band this is exactly "3 consecutive scans at or inside
    to raise, 4 consecutive outside to clear", with one number instead of counters per band.

    Scans are counted, and time bounds the count when the sensor turns slowly: two scans that together took 0.3 s
    raise, two that took 0.4 s clear. Scans further apart than ``max_gap_s`` are not consecutive, and what was agreed on
    before is forgotten: see ``Silence``.
    """

    def __init__(self, config: PersistenceSection) -> None:
        self._config = config
        self._scans: deque[tuple[int, int, float]] = deque(maxlen=max(config.raise_scans, config.clear_scans))
        self._last_ns: int | None = None
        self.agreed_m = math.inf

    def update(self, stamp_ns: int, nearest_m: float) -> float:
        """The agreed distance after a scan that ended at ``stamp_ns``."""
        last_ns, self._last_ns = self._last_ns, stamp_ns
        if last_ns is not None and not 0 <= stamp_ns - last_ns <= self._config.max_gap_s * 1e9:
            self.forget()
            last_ns = None
        began_ns = stamp_ns if last_ns is None else last_ns
        self._scans.append((began_ns, stamp_ns, nearest_m))
        raised = self._last(self._config.raise_scans, self._config.raise_s)
        cleared = self._last(self._config.clear_scans, self._config.clear_s)
        if raised and max(raised) < self.agreed_m:
            self.agreed_m = max(raised)
        elif cleared and min(cleared) > self.agreed_m:
            self.agreed_m = min(cleared)
        return self.agreed_m

    def carry(self, nearer_m: float) -> None:
        """The vehicle has driven on: every distance is less by so much, but never behind the bumper."""
        scans = [
            (began_ns, ended_ns, max(0.0, distance_m - nearer_m)) for began_ns, ended_ns, distance_m in self._scans
        ]
        self._scans.clear()
        self._scans.extend(scans)
        self.agreed_m = max(0.0, self.agreed_m - nearer_m)

    def forget(self) -> None:
        """Nothing is known."""
        self._scans.clear()
        self.agreed_m = math.inf

    def _last(self, count: int, span_s: float) -> list[float]:
        """The newest ``count`` distances, or fewer (but two) that span the time; empty when there are not enough."""
        if count == 1 and self._scans:
            return [self._scans[-1][2]]
        newest_ns = self._scans[-1][1] if self._scans else 0
        chosen: list[float] = []
        for began_ns, _, distance_m in reversed(self._scans):
            chosen.append(distance_m)
            if len(chosen) == count or (len(chosen) >= 2 and newest_ns - began_ns >= span_s * 1e9):
                return chosen
        return []


class Silence:
    """After a silence longer than ``max_gap_s`` nothing is known: neither the old alarm nor its absence.

    The lanes are forgotten, and until enough scans have seen something to raise an alarm the sensor is degraded: its
    alarms count, its "all clear" does not.
    """

    def __init__(self, config: PersistenceSection) -> None:
        self._config = config
        self._last_ns: int | None = None
        self._missing = 0
        self._text = ""

    def ended(self, stamp_ns: int) -> bool:
        """True for the first scan after a silence; called once with every scan's stamp."""
        last_ns, self._last_ns = self._last_ns, stamp_ns
        if last_ns is None or 0 <= stamp_ns - last_ns <= self._config.max_gap_s * 1e9:
            return False
        self._missing = self._config.raise_scans
        step_s = (stamp_ns - last_ns) * 1e-9
        what = f"no scan for {step_s:.1f} s" if step_s > 0 else f"the scans' time went back by {-step_s:.3f} s"
        self._text = f"{what}: looking again"
        return True

    def reason(self, could_see: bool) -> str:
        """Why the lanes cannot be believed yet, "" once they can; called once with every scan."""
        self._missing -= bool(self._missing and could_see)
        return self._text if self._missing else ""
