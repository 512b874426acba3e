"""What has to hold in every world, judged from the truth: who reported which body, and who saw it gone."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from common.messages import Verdict
from services.jetson.fusion.config import RulesConfig

REACTION_S, BRAKE_MPS2, MARGIN_M = 0.5, 2.0, 0.3
NEAR_M = 0.8  # and never less than the lidar's IMMINENT
HALF_WIDTH_M = 0.1
LOOKED_S = 1.5  # the clear count and some lost messages, after a place has come into view
LOOKS_RAD = 0.3  # the narrowest sensor looks at what is this far off the middle
STEADY_S = 10.0
ALARM_RULES = frozenset({"R1-worst-case", "R3-confirmed", "R5-camera-stands-in", "H1-held", "N1-near-range"})


@dataclass
class Outcome:
    """Of one world. ``first`` is the first fault."""

    seed: int
    steps: int = 0
    unsafe: int = 0  # verdicts SAFE close to a body that was reported and not seen gone
    outlived: int = 0  # verdicts that alarm although all sensors see that everything is gone
    errors: int = 0
    worst_changes: int = 0  # of level and permission in a second of steady input
    alarmed_s: float = 0.0
    first: str = ""

    @property
    def wrong(self) -> int:
        """How bad a world it is."""
        return self.unsafe + self.outlived + self.errors + max(0, self.worst_changes - 2)


@dataclass
class Known:
    """The messages of one sensor to fusion about one body."""

    reported: bool = False
    without: int = 0  # messages in a row, online, that did not show it at alarm level


@dataclass
class Judge:
    """Fed with what fusion used and what is true."""

    outcome: Outcome
    rules: RulesConfig = field(default_factory=RulesConfig)
    known: dict[tuple[int, str], Known] = field(default_factory=dict)
    used_ns: dict[str, int] = field(default_factory=dict)
    clear: dict[str, int] = field(default_factory=dict)  # messages in a row, online, with no alarm at all
    looked_since_s: dict[str, float] = field(default_factory=dict)  # since when a sensor looks at its claims' places
    said: deque[tuple[float, str, str]] = field(default_factory=deque)

    def note_used(
        self, name: str, verdict: Verdict, alarming: dict[int, set[int]], bodies: dict[int, tuple[str, ...]]
    ) -> None:
        """``alarming``: by stamp, the bodies that the message showed at alarm level."""
        used = verdict.inputs.get(name)
        if used is None or used.state == "disconnected" or used.stamp_ns == self.used_ns.get(name):
            return
        self.used_ns[name] = used.stamp_ns
        shown = alarming.get(used.stamp_ns, set())
        lidar = verdict.inputs.get("lidar")
        counts = name != "camera" or (
            used.state == "online" and (lidar is None or lidar.state != "online" or verdict.confirmed)
        )
        online = used.state == "online"
        self.clear[name] = 0 if shown else self.clear.get(name, 0) + online
        for number, seen_by in bodies.items():
            known = self.known.setdefault((number, name), Known())
            if number in shown and counts:
                known.reported, known.without = True, 0
            elif number not in shown and online and name in seen_by:
                known.without += 1
                if known.without >= self.rules.clear_messages:
                    self._gone(number)
            if name == "lidar" and online and not shown:  # a clear lidar outvotes the camera alone (R2)
                self.known.pop((number, "camera"), None)

    def _gone(self, number: int) -> None:
        for (body, _), known in self.known.items():
            if body == number:
                known.reported = False

    def left_behind(self, number: int) -> None:
        """The vehicle has passed it."""
        self._gone(number)

    def verdict(self, now_s: float, verdict: Verdict, ahead: dict[int, tuple[float, float]], speed_mps: float) -> None:
        """``ahead``: where the bodies are now, ahead and left of the front."""
        outcome, stop_m = self.outcome, stopping_m(speed_mps)
        outcome.steps += 1
        outcome.alarmed_s += 0.05 * (verdict.level != "SAFE")
        if verdict.level == "SAFE":
            for (number, name), known in self.known.items():
                x, y = ahead.get(number, (math.inf, 0.0))
                if known.reported and 0.05 < x <= stop_m and abs(y) <= HALF_WIDTH_M:
                    outcome.unsafe += 1
                    self._first(now_s, f"SAFE ({verdict.rule}) {x:.2f} m before body {number} that the {name} reported")
                    break
        for claim in verdict.claims:
            looked_at = claim.x_m is None or math.atan2(abs(claim.y_m or 0.0), claim.x_m or 1e-9) < LOOKS_RAD
            if not looked_at:
                self.looked_since_s.pop(claim.by, None)
            since_s = self.looked_since_s.setdefault(claim.by, now_s)
            if not looked_at or claim.level == "SAFE" or now_s - since_s < LOOKED_S:
                continue
            if self.clear.get(claim.by, 0) > self.rules.clear_messages and verdict.rule in ALARM_RULES:
                outcome.outlived += 1
                self._first(
                    now_s, f"{claim.by} still claims {claim.level}, after {self.clear[claim.by]} clear messages"
                )

    def changes(self, now_s: float, verdict: Verdict, steady_since_s: float) -> None:
        """Changes within a second, of input that has been steady for long."""
        if now_s - steady_since_s < STEADY_S:
            self.said.clear()
            return
        if not self.said or self.said[-1][1:] != (verdict.level, verdict.permission):
            self.said.append((now_s, verdict.level, verdict.permission))
        while self.said and now_s - self.said[0][0] > 1.0 and len(self.said) > 1:
            self.said.popleft()
        changes = len(self.said) - 1
        if changes > self.outcome.worst_changes:
            self.outcome.worst_changes = changes
            if changes > 2:
                self._first(now_s, f"{changes} changes in a second of steady input")

    def _first(self, now_s: float, text: str) -> None:
        self.outcome.first = self.outcome.first or f"{now_s:.2f} s: {text}"


def stopping_m(speed_mps: float) -> float:
    """Reaction, braking and a margin; never less than the lidar's near band."""
    forward_mps = max(0.0, speed_mps)
    return max(NEAR_M, forward_mps * REACTION_S + forward_mps**2 / (2 * BRAKE_MPS2) + MARGIN_M)
