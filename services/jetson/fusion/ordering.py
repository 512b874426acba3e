"""The order of one sensor's messages: repeated and overtaken ones are dropped, two senders on one key are noticed."""

from __future__ import annotations

from collections import deque
from typing import Any

from common.bus.pubsub import Received

TWO_SENDERS_AFTER = 3  # times that the sequence number went back, within
TWO_SENDERS_WITHIN_S = 2.0


class Ordering:
    """``check`` every message before it is used. A new order that persists for ``patience_s`` is accepted."""

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
        self._last: Received[Any] | None = None
        self._sender = ""
        self._went_back_s: deque[float] = deque(maxlen=TWO_SENDERS_AFTER)

    def check(self, received: Received[Any], sender: str, *, announced: bool = False) -> str:
        """Why this message is not to be used; empty when it is.

        ``sender`` changes when the process does; ``announced``: two may speak, one takes over from the other.
        """
        last, new = self._last, received.message
        same_sender, self._sender = sender == self._sender, sender
        if last is not None and new.seq <= last.message.seq:
            patient = received.arrived_s - last.arrived_s <= self._patience_s
            if new.stamp_ns <= last.message.stamp_ns and patient:
                return "repeated" if new.stamp_ns == last.message.stamp_ns else "out of order"
            if same_sender and not announced:  # a new measurement under an old number: a restart has another instance
                self._went_back_s.append(received.arrived_s)
        self._last = received
        return ""

    def two_senders(self, now_s: float) -> bool:
        """The numbers keep going back although the process is the same: somebody else sends on this key as well."""
        went_back_s = self._went_back_s
        return len(went_back_s) == TWO_SENDERS_AFTER and now_s - went_back_s[0] <= TWO_SENDERS_WITHIN_S
