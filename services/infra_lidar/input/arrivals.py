"""Counts the senders to a UDP port and says in a sentence why no revolution comes of their packets. No I/O."""

from __future__ import annotations

import logging
import math
import threading
from collections import Counter

from services.infra_lidar.input.sensors import Sender, model_of

log = logging.getLogger(__name__)

MAX_NAMED = 4  # senders
RECENT_S = 0.5  # without a packet for this long the sensor is silent


class Arrivals:
    """Packets that came to a port since ``forget``. One thread writes, another reads."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._lock = threading.Lock()
        self._unfit: Counter[Sender] = Counter()  # of the sensor, by what their packets look like
        self._strangers: Counter[Sender] = Counter()
        self._logged: set[Sender] = set()
        self._fitting_s = -math.inf

    def forget(self) -> None:
        """Reset the counts, for example after the source was opened again."""
        with self._lock:
            self._unfit.clear()
            self._strangers.clear()

    def fitting(self, now_s: float) -> None:
        """A packet was usable; ``now_s`` is monotonic."""
        self._fitting_s = now_s

    def unfit(self, address: str, packet: bytes) -> None:
        """A packet of the configured sensor was not usable."""
        self._count(self._unfit, address, packet)

    def stranger(self, address: str, packet: bytes) -> None:
        """A packet came from another address than the configured sensor's."""
        sender = self._count(self._strangers, address, packet)
        if sender not in self._logged and len(self._logged) < MAX_NAMED:
            self._logged.add(sender)
            log.warning("UDP port %d also gets packets of %s; they are not used", self._port, sender)

    def _count(self, seen: Counter[Sender], address: str, packet: bytes) -> Sender:
        sender = Sender(address, self._port, model_of(packet))
        with self._lock:
            if sender in seen or len(seen) < MAX_NAMED:
                seen[sender] += 1
        return sender

    def why_nothing(self, now_s: float) -> str:
        """Why no revolution comes: the sensor's packets do not fit, only other senders send, or no packets come."""
        with self._lock:
            unfit = " and ".join(f"{count} packets of {sender}" for sender, count in sorted(self._unfit.items()))
            strangers = "; ".join(sorted(map(str, self._strangers)))
        if now_s - self._fitting_s < RECENT_S:
            return (
                f"UDP port {self._port} has packets of the sensor, but no revolution was completed; check how it turns "
                f"and what the counters say"
            )
        if unfit:
            return (
                f"UDP port {self._port} has {unfit}, none of the expected kind or size; check the sensor's mode, and "
                f"the metadata or calibration of `source`"
            )
        if strangers:
            return f"UDP port {self._port} has no packets of the sensor that is configured, but of {strangers}"
        return f"no packets on UDP port {self._port}; check the sensor's power, cable, address"
