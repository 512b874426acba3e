"""Fusion's memory a second time, as plain as possible and without any of fusion's code: part two of the rules' page.

``MACHINES`` is one state diagram per rule that remembers; ``sections()`` draws them. ``LidarClaim``, ``Budget`` and
``StartUp`` are the same rules as counters, for one sensor and without places; the tests run them beside fusion over
random histories. Levels are numbers (0 SAFE, 1 CAUTION, 2 IMMINENT, None nothing seen).
"""

from __future__ import annotations

from typing import NamedTuple

CLEAR_MESSAGES, DECAY_S = 8, 10.0
BUDGET_S, REFILL_S = 1.0, 30.0
START_S = 10.0


class Machine(NamedTuple):
    """One diagram: (from, event, to); ``[*]`` is nothing remembered."""

    title: str
    what: str
    steps: tuple[tuple[str, str, str], ...]


MACHINES = (
    Machine(
        "`R1-worst-case`, `N1-near-range`, `R9-static-radar`, `H1-held`: an alarm of a sensor that measures range",
        "Lost is where its sensor is out. Every state but the first demands the claim's level. What one scan of\n"
        "the LiDAR shows, before it has agreed on it, counts as shown.",
        (
            ("[*]", "one message shows it", "Seen"),
            ("Seen", "a message shows it, at this level or a worse one", "Seen"),
            ("Seen", "a message shows less, or nothing", "Fading"),
            ("Fading", "a message shows it again", "Seen"),
            ("Fading", "8 in a row show less", "Seen: at the worst level of those"),
            ("Fading", "8 in a row show nothing", "[*]"),
            ("Seen", "sensor degraded, disconnected, dead, undated", "Lost"),
            ("Fading", "sensor degraded, disconnected, dead, undated", "Lost"),
            ("Lost", "fusion restarts", "Lost"),
            ("Lost", "a degraded message shows it", "Seen"),
            ("Lost", "sensor back online", "Fading"),
            ("Lost", "another sensor that has seen it, 8 in a row without it", "[*]"),
            ("Lost", "left behind by known motion", "[*]"),
            ("Lost", "a person acknowledges", "[*]"),
            ("Lost", "IMMINENT, and standing for 10 s", "Lost: CAUTION"),
        ),
    ),
    Machine(
        "`R3-confirmed`, `R5-camera-stands-in`: the camera's word",
        "Advice alone (`R2-camera-only`) dies with the camera. Counted demands its level, at least CAUTION.",
        (
            ("[*]", "one picture shows it", "Seen"),
            ("Seen", "8 pictures in a row show nothing", "[*]"),
            ("Seen", "camera out", "[*]"),
            ("Seen", "it confirms, or stands in for the LiDAR", "Counted"),
            ("Counted", "8 pictures in a row show nothing", "[*]"),
            ("Counted", "camera out", "Lost"),
            ("Lost", "camera back online", "Counted"),
            ("Lost", "8 messages of a clear LiDAR that had seen it, or that it stood in for", "[*]"),
            ("Lost", "left behind, or a person acknowledges", "[*]"),
            ("Lost", "IMMINENT, and standing for 10 s", "Lost: CAUTION"),
        ),
    ),
    Machine(
        "`I1-roadside`: an alarm of the roadside LiDAR",
        "Its own three messages in a row make a threat; from there it is an alarm like the first.",
        (
            ("[*]", "a threat in three messages", "Seen"),
            ("Seen", "8 messages without a threat", "[*]"),
            ("Seen", "link cut, service dead, own pose unknown", "Lost"),
            ("Lost", "back, and 8 messages without a threat", "[*]"),
            ("Lost", "left behind, or a person acknowledges", "[*]"),
            ("Lost", "IMMINENT, and standing for 10 s", "Lost: CAUTION"),
        ),
    ),
    Machine(
        "`R4-suppressed`: what an empty picture may hold back",
        "Held back only in Drawing, and only while all sensors are online and the picture is fresh and empty.",
        (
            ("[*]", "LiDAR CAUTION that nobody shares", "Drawing"),
            ("Drawing", "1.0 s of this detection is over", "Spent"),
            ("Drawing", "IMMINENT, nearer by 0.10 m, or anybody else sees something", "Spent"),
            ("Drawing", "LiDAR clear for 30 s", "[*]"),
            ("Spent", "LiDAR clear for 30 s", "[*]"),
        ),
    ),
    Machine(
        "`A25-starting`, and the state of every sensor",
        "A restart of fusion within 60 s goes on where it stopped.",
        (
            ("[*]", "fusion starts", "Starting"),
            ("Starting", "every fitted sensor has sent a message, or 10 s are over", "Started"),
            ("Started", "a sensor has a fault", "Out"),
            ("Out", "3 good frames in a row", "Started"),
            ("Out", "a second fault within 4 s", "Flickering"),
            ("Flickering", "20 good frames in a row", "Started"),
        ),
    ),
)  # fmt: skip


def diagram(machine: Machine) -> list[str]:
    """Mermaid, which GitHub draws."""
    lines = ["```mermaid", "stateDiagram-v2"]
    for begin, event, end in machine.steps:
        state, _, note = end.partition(": ")
        lines.append(f"    {begin} --> {state}: {event}{f' ({note})' if note else ''}")
    return [*lines, "```"]


def sections() -> list[str]:
    """Part two of the page."""
    lines = [
        "# Memory",
        "",
        "The table answers for one moment. What a moment leaves for the next is below, one diagram per rule; generated",
        "by `tests/jetson/fusion/written_memory.py`, which also has the rules as plain counters: the tests run those",
        "beside fusion over random histories. An alarm is a claim about a place; absence ends none.",
    ]
    for machine in MACHINES:
        lines += ["", f"## {machine.title}", "", machine.what, "", *diagram(machine)]
    return lines


class LidarClaim:
    """The LiDAR's alarm as one counter: what it votes after each message."""

    def __init__(self) -> None:
        self.level: int | None = None  # None = no claim
        self.since_seen: list[int] = []
        self.seen_s = 0.0

    def step(self, now_s: float, state: str, seen: tuple[int, int], standing: bool, acknowledged: bool) -> int | None:
        """One message (agreed on; in this one alone); returns the vote, None = none."""
        level, alone = seen
        shown = level if state != "disconnected" and level >= 1 else 0
        live = False
        if shown and (self.level is None or shown >= self.level):
            self.level, self.since_seen, self.seen_s, live = shown, [], now_s, True
        elif self.level is not None and state == "online" and alone > level and alone >= self.level:
            self.since_seen = []
        elif self.level is not None and state == "online":
            self.since_seen.append(max(shown, alone) if alone > level else shown)
            if len(self.since_seen) == CLEAR_MESSAGES:
                rest = max(self.since_seen)
                if rest and shown == rest:
                    self.level, self.since_seen, self.seen_s, live = rest, [], now_s, True
                elif rest:
                    last = max(i for i, one in enumerate(self.since_seen) if one == rest)
                    self.level, self.since_seen = rest, self.since_seen[last + 1 :]
                else:
                    self.level = None
        if self.level == 2 and standing and state != "online" and now_s - self.seen_s >= DECAY_S:
            self.level = 1
        if acknowledged and not live:
            self.level = None
        if self.level is not None:
            return self.level
        return 0 if state == "online" else None
