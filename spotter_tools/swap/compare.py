"""Are the candidate's messages as good as the live service's? Pure functions of the received messages."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from common.messages import LEVELS, Message
from common.topics import Topic
from spotter_tools.wording import without_numbers

# Per field of an object: how far two services may differ and still mean the same object.
GATES = {
    "RadarTracks": ("tracks", ("range_m", "velocity_mps"), (1.0, 1.0)),
    "ObjectTracks": ("tracks", ("position_m",), (1.5, 1.5, 1.5)),
    "CameraDetections": ("detections", ("distance_m",), (1.0,)),
}
ZONE_GATE_M = 0.5
# Two of the same kind look at different moments: a level counts as lower when it is not reached a little earlier or
# later either.
LEVEL_SLACK_S = 0.2


class Limits(msgspec.Struct, frozen=True, kw_only=True):
    """What a candidate has to reach."""

    rate: float = 0.9  # of the live one's
    latency: float = 1.5  # times the live one's 95th percentile ...
    latency_slack_ms: float = 50.0  # ... plus this
    matches: float = 0.8  # of the objects of both
    weaker: float = 0.05  # of the paired messages may show a lower level than the live one


@dataclass(frozen=True)
class Received:
    """One message and when it came, in seconds on our clock."""

    message: Message
    arrived_s: float


class Comparison(msgspec.Struct, frozen=True, kw_only=True):
    """Figures of one comparison; ``None`` = nothing to compare."""

    seconds: float
    live_hz: float
    candidate_hz: float
    live_p95_ms: float | None
    candidate_p95_ms: float | None
    pairs: int
    matches: float | None
    weaker: float | None
    stronger: float | None
    faults: tuple[str, ...] = ()


def compare(topic: Topic, seconds: float, live: list[Received], candidate: list[Received]) -> Comparison:
    """Rates, latencies from measurement to sending, objects in common, and levels, over the same ``seconds``."""
    pairs = _pairs(topic, live, candidate)
    shares = [share for a, b in pairs if (share := in_common(a, b)) is not None]
    known = {without_numbers(_fault(received.message)) for received in live}
    faults = {reason for received in candidate if without_numbers(reason := _fault(received.message)) not in known}
    return Comparison(
        seconds=seconds,
        live_hz=round(len(live) / seconds, 2),
        candidate_hz=round(len(candidate) / seconds, 2),
        live_p95_ms=_p95_ms(live),
        candidate_p95_ms=_p95_ms(candidate),
        pairs=len(pairs),
        matches=round(float(np.mean(shares)), 3) if shares else None,
        weaker=_not_reached([a for a, _ in pairs], candidate),
        stronger=_not_reached([b for _, b in pairs], live),
        faults=tuple(sorted(faults - {""}))[:3],
    )


def refuse(found: Comparison, limits: Limits) -> list[str]:
    """Why the candidate may not take over; empty when it may."""
    reasons = []
    if not found.candidate_hz:
        return ["it published nothing"]
    if found.candidate_hz < limits.rate * found.live_hz:
        reasons.append(f"{found.candidate_hz:.1f} Hz, the live one {found.live_hz:.1f} Hz")
    if found.live_p95_ms is not None and found.candidate_p95_ms is not None:
        allowed_ms = limits.latency * found.live_p95_ms + limits.latency_slack_ms
        if found.candidate_p95_ms > allowed_ms:
            reasons.append(f"latency {found.candidate_p95_ms:.0f} ms (95 %), allowed {allowed_ms:.0f} ms")
    if not found.pairs:
        reasons.append("none of its messages has the time of a live one")
    if found.matches is not None and found.matches < limits.matches:
        reasons.append(f"only {found.matches:.0%} of the objects in common, {limits.matches:.0%} needed")
    if found.weaker is not None and found.weaker > limits.weaker:
        reasons.append(f"a lower level than the live one in {found.weaker:.0%} of the messages")
    return reasons + [f"it says: {fault}" for fault in found.faults]


def in_common(a: Message, b: Message) -> float | None:
    """Share of the objects of two messages that have a partner in the other one; None when neither has any."""
    if hasattr(a, "left"):
        return _zones_in_common(a, b)
    if type(a).__name__ not in GATES:
        return None
    attribute, keys, gates = GATES[type(a).__name__]
    first, second = (_table(getattr(message, attribute), keys) for message in (a, b))
    if not len(first) and not len(second):
        return None
    return 2 * _matched(first, second, np.array(gates)) / (len(first) + len(second))


def _table(objects: list[object], keys: tuple[str, ...]) -> np.ndarray:
    rows = [np.hstack([np.asarray(getattr(one, key), float) for key in keys]) for one in objects]
    return np.array(rows)


def _matched(first: np.ndarray, second: np.ndarray, gates: np.ndarray) -> int:
    """How many pairs lie within the gates, each object used once, nearest first."""
    if not len(first) or not len(second):
        return 0
    apart = np.max(np.abs(first[:, None] - second[None]) / gates, axis=2)
    matched = 0
    while apart.size and apart.min() <= 1.0:
        row, column = np.unravel_index(int(apart.argmin()), apart.shape)
        apart[row, :], apart[:, column] = np.inf, np.inf
        matched += 1
    return matched


def _zones_in_common(a: Message, b: Message) -> float | None:
    distances = [(getattr(a, zone).nearest_m, getattr(b, zone).nearest_m) for zone in ("left", "centre", "right")]
    occupied = [(x, y) for x, y in distances if x is not None or y is not None]
    if not occupied:
        return None
    same = [x is not None and y is not None and abs(x - y) <= ZONE_GATE_M for x, y in occupied]
    return sum(same) / len(same)


def _pairs(topic: Topic, live: list[Received], candidate: list[Received]) -> list[tuple[Message, Message]]:
    """For each candidate's message the live one nearest in measurement time, at most half a period away."""
    if not live or not candidate:
        return []
    limit_ns = 0.6e9 / (topic.nominal_hz or 10.0)
    stamps_ns = np.array([received.message.stamp_ns for received in live])
    pairs = []
    for received in candidate:
        apart_ns = np.abs(stamps_ns - received.message.stamp_ns)
        nearest = int(apart_ns.argmin())
        if apart_ns[nearest] <= limit_ns:
            pairs.append((live[nearest].message, received.message))
    return pairs


def _not_reached(shown: list[Message], others: list[Received]) -> float | None:
    """Share of the messages whose level none of the others' messages of that time has; None where there are none."""
    if not shown or not hasattr(shown[0], "level"):
        return None
    their_stamps_ns = np.array([received.message.stamp_ns for received in others])
    their_ranks = np.array([_rank(received.message) for received in others])
    short = 0
    for message in shown:
        near = np.abs(their_stamps_ns - message.stamp_ns) <= LEVEL_SLACK_S * 1e9
        short += int(their_ranks[near].max(initial=0) < _rank(message))
    return round(short / len(shown), 3)


def _rank(message: Message) -> int:
    level = getattr(message, "level", None)
    return 0 if level is None else LEVELS.index(level)


def _fault(message: Message) -> str:
    return str(getattr(message, "reason", "")) if getattr(message, "state", "online") != "online" else ""


def _p95_ms(received: list[Received]) -> float | None:
    waits_ms = [(h.message.sent_ns - h.message.stamp_ns) * 1e-6 for h in received if h.message.sent_ns]
    return round(float(np.percentile(waits_ms, 95)), 1) if waits_ms else None
