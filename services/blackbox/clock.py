"""How far this host's clock is from fusion's, measured all the time: what lets the hosts' capsules be laid together."""

from __future__ import annotations

import threading

import zenoh

from common.bus.runtime import Service
from common.clock import monotonic_s
from services.blackbox.capsule import HostClock
from services.jetson.fusion.clocks import ClockSample, ClockWatch
from services.jetson.fusion.config import ClocksConfig
from services.jetson.fusion.source import ask

PERIOD_S = 1.0


class FusionClock:
    """Asks fusion for the time, once a second, in a thread of its own; ends with the session."""

    def __init__(self, service: Service, fusion_host: str) -> None:
        self._session, self._fusion_host = service.session, fusion_host
        self._same_host = service.host == fusion_host
        self._watch, self._lock = ClockWatch(ClocksConfig()), threading.Lock()
        self._pause = threading.Event()
        if not self._same_host:
            threading.Thread(target=self._poll, name="clock", daemon=True).start()

    def now(self) -> HostClock:
        """This host's clock minus fusion's and within what that is true; fusion's own host has fusion's clock."""
        if self._same_host:
            return HostClock(0.0, 0.0)
        with self._lock:
            best = self._watch.estimate(monotonic_s())
        return HostClock(-best.offset_s, best.bound_s) if best else HostClock(None, None)

    def _poll(self) -> None:
        while not self._pause.wait(PERIOD_S):
            try:
                sample: ClockSample | None = ask(self._session, self._fusion_host, "fusion")
            except zenoh.ZError:
                return  # the session is closed
            if sample is not None:
                with self._lock:
                    self._watch.add(sample)
