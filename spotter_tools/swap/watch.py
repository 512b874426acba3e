"""What the messages received during a swap say about the switchover: gaps, losses, flaps. Pure functions."""

from __future__ import annotations

from itertools import pairwise

import msgspec
import numpy as np

from common.messages import Message, SystemHealth, Verdict
from spotter_tools.swap.compare import Received


class Gap(msgspec.Struct, frozen=True, kw_only=True):
    """Figures of the switchover from the messages of a topic.

    A busy machine misses measurements at all times, so the same figures are given for the time before.
    """

    messages: int
    change_ms: float  # from the old one's last message to the new one's first; negative: both published for so long
    longest_gap_ms: float  # between arrivals
    longest_gap_before_ms: float
    usual_gap_ms: float  # median
    missed: int  # measurements, at the usual spacing, that neither process published
    missed_before: int
    lost: int  # published but not received, by the sequence numbers
    verdict_flaps: int  # level changed and came back within a second
    verdict_flaps_before: int
    health_flaps: int  # the sensor left online
    health_flaps_before: int


def by_sender(live: list[Received], last_old: int, last_new: int) -> tuple[list[Received], list[Received]]:
    """Divide the messages between the old process and its successor: each continues its own sequence numbers.

    ``last_old`` and ``last_new`` are the last numbers before the switchover, the new one\'s in the shadow.
    """
    next_seq = [last_old + 1, last_new + 1]
    sent: tuple[list[Received], list[Received]] = ([], [])
    sender = 0
    for received in live:
        apart = [abs(received.message.seq - expected) for expected in next_seq]
        if apart[0] != apart[1]:  # else the sender of the last message: one sequence may pass the end of the other
            sender = int(apart[1] < apart[0])
        sent[sender].append(received)
        next_seq[sender] = received.message.seq + 1
    return sent


def measure_switchover(
    service: str,
    before: list[Received],
    old: list[Received],
    new: list[Received],
    verdicts: list[Received],
    health: list[Received],
) -> Gap:
    """Gaps of the topic before and after the switchover from ``old`` to ``new``, and flaps of verdict and health.

    ``verdicts`` and ``health`` cover the times before and after.
    """
    live = sorted(old + new, key=lambda received: received.arrived_s)
    levels = [(received.arrived_s, level_of(received.message)) for received in verdicts]
    change_s = before[-1].arrived_s if before else 0.0
    flaps_before = flaps([row for row in levels if row[0] <= change_s])
    left_before = left_online(service, [received for received in health if received.arrived_s <= change_s])
    usual_s = float(np.median(arrival_gaps_s(before))) if len(before) > 1 else 0.0
    return Gap(
        messages=len(live),
        change_ms=round((new[0].arrived_s - (before + old)[-1].arrived_s) * 1e3, 1) if new else 0.0,
        longest_gap_ms=round(max(arrival_gaps_s(before[-1:] + live), default=0.0) * 1e3, 1),
        longest_gap_before_ms=round(max(arrival_gaps_s(before), default=0.0) * 1e3, 1),
        usual_gap_ms=round(usual_s * 1e3, 1),
        missed=missed(before[-1:] + live, usual_s),
        missed_before=missed(before, usual_s),
        lost=lost(old) + lost(new),
        verdict_flaps=flaps(levels) - flaps_before,
        verdict_flaps_before=flaps_before,
        health_flaps=left_online(service, health) - left_before,
        health_flaps_before=left_before,
    )


def arrival_gaps_s(received: list[Received]) -> list[float]:
    """Seconds between consecutive messages."""
    return [later.arrived_s - earlier.arrived_s for earlier, later in pairwise(received)]


def missed(received: list[Received], usual_s: float) -> int:
    """Measurements that no message carries: a late message is not missed, and a duplicate replaces no other."""
    stamps_s = sorted(one.message.stamp_ns * 1e-9 for one in received)
    return sum(max(0, round((b - a) / usual_s) - 1) for a, b in pairwise(stamps_s)) if usual_s else 0


def lost(received: list[Received]) -> int:
    """Sequence numbers of one sender that are missing."""
    return sum(max(0, later.message.seq - earlier.message.seq - 1) for earlier, later in pairwise(received))


def flaps(levels: list[tuple[float, str]], within_s: float = 1.0) -> int:
    """How often a level was left and came back within this time: a real approach takes longer."""
    changes = [row for i, row in enumerate(levels) if i == 0 or row[1] != levels[i - 1][1]]
    return sum(
        changes[i + 1][1] == changes[i - 1][1] and changes[i + 1][0] - changes[i][0] < within_s
        for i in range(1, len(changes) - 1)
    )


def level_of(message: Message) -> str:
    """The verdict's level; empty for any other message."""
    return message.level if isinstance(message, Verdict) else ""


def left_online(service: str, health: list[Received]) -> int:
    """How often fusion's state of the sensor changed from online to another one."""
    messages = [received.message for received in health if isinstance(received.message, SystemHealth)]
    states = [message.sensors[service].state for message in messages if service in message.sensors]
    return sum(earlier == "online" and later != "online" for earlier, later in pairwise(states))
