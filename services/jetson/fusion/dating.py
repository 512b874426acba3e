"""How old a message is: by its stamp and its sender's clock when it came, by our monotonic clock ever since."""

from __future__ import annotations

from typing import NamedTuple

from common.bus.pubsub import M, Received


class SenderClock(NamedTuple):
    """What is known of a sender's clock: theirs minus ours, true within ``bound_s``."""

    offset_s: float = 0.0
    bound_s: float = 0.0


SAME_CLOCK = SenderClock()


class Age(NamedTuple):
    """Of a message's measurement when it arrived."""

    arrived_s: float  # monotonic
    at_arrival_s: float  # by its stamp; negative = from the future
    bound_s: float = 0.0  # true within

    def now(self, now_s: float) -> float:
        """Seconds since the measurement, the best estimate; a stamp from the future counts as arrival."""
        return max(0.0, now_s - self.arrived_s) + max(0.0, self.at_arrival_s)

    def at_most(self, now_s: float) -> float:
        """Seconds since the measurement, as old as it may be."""
        return self.now(now_s) + self.bound_s


def age_of(received: Received[M], clock: SenderClock) -> Age:
    """The age of a message from the clock of its sender."""
    at_arrival_s = (received.arrived_ns - received.message.stamp_ns) * 1e-9 + clock.offset_s
    return Age(received.arrived_s, at_arrival_s, clock.bound_s)
