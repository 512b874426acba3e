"""What arrives on fusion's key: read, put in order, and held against who is there. Pure."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

from common.bus.presence import claimants
from common.codec import DecodeError, decode, encoding_of
from common.messages import Verdict
from common.topics import FUSION_VERDICT
from services.jetson.gate.checks import GateInputs

TWO_SENDERS_HELD_S = 2.0


class Arrival(NamedTuple):
    """One message as it came."""

    payload: bytes
    encoding: str
    at_s: float  # monotonic
    at_ns: int  # UTC, against the verdict's own stamp


class VerdictInbox:
    """Keeps the newest verdict. One router delivers one sender in order: a number that goes back is another sender."""

    def __init__(self) -> None:
        self._verdict: Verdict | None = None
        self._arrived: Arrival | None = None
        self._refused = ""
        self._instances: frozenset[str] = frozenset()
        self._two_senders_s = float("-inf")
        self.ignored = 0  # repetitions

    def meet(self, instances: Collection[str]) -> None:
        """The liveliness tokens of fusion that are up now. Another process counts from the beginning."""
        now = frozenset(instances)
        if now != self._instances and not now & self._instances:
            self._verdict = self._arrived = None
        self._instances = now

    def take(self, arrival: Arrival) -> None:
        """One message, in the order of arrival."""
        if arrival.encoding != encoding_of(Verdict):
            self._refused = f"unknown version: {arrival.encoding[:80]!r}, expected {encoding_of(Verdict)!r}"
            return
        try:
            verdict = decode(arrival.payload, Verdict, FUSION_VERDICT.max_bytes)
        except DecodeError as error:
            self._refused = f"undecodable: {error}"[:300]
            return
        last = self._verdict
        if last is not None and verdict.seq <= last.seq and not self._handing_over:
            if (verdict.seq, verdict.stamp_ns) == (last.seq, last.stamp_ns):
                self.ignored += 1
                return
            self._two_senders_s = arrival.at_s
        self._verdict, self._arrived, self._refused = verdict, arrival, ""

    def inputs(self, now_s: float) -> GateInputs:
        """All of it at ``now_s``."""
        return GateInputs(
            verdict=self._verdict,
            age_s=self._age_s(now_s),
            claimants=tuple(sorted(claimants(self._instances))) if self._instances else (),
            refused=self._refused,
            two_senders=now_s - self._two_senders_s < TWO_SENDERS_HELD_S,
        )

    @property
    def _handing_over(self) -> bool:
        """The old fusion and its announced successor are both there."""
        return len(self._instances) > len(claimants(self._instances))

    def _age_s(self, now_s: float) -> float:
        """Since fusion stamped it: by its stamp when it arrived, on our own monotonic clock since then."""
        if self._verdict is None or self._arrived is None:
            return 0.0
        return (self._arrived.at_ns - self._verdict.stamp_ns) * 1e-9 + now_s - self._arrived.at_s
