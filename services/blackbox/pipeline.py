"""Arrivals in, complete incidents out. No network, no clock: time is that of the arrivals, in monotonic seconds."""

from __future__ import annotations

from dataclasses import dataclass, replace

from common.codec import DecodeError, decode
from common.topics import FUSION_HEALTH, FUSION_VERDICT, Topic
from services.blackbox.config import BlackboxConfig
from services.blackbox.ring import Kept, Ring
from services.blackbox.trigger import Incident, Trigger


@dataclass(frozen=True)
class Saved:
    """An incident whose window has passed, with everything in it."""

    incident: Incident
    kept: list[Kept]


class BlackboxPipeline:
    """Keeps the ring and the open incident; what happens during an open incident's window belongs to it."""

    def __init__(self, config: BlackboxConfig) -> None:
        self._before_s, self._after_s = config.before_s, config.after_s
        self._ring = Ring(config.before_s + config.after_s + 2.0, int(config.max_mb * 1e6))
        self._trigger = Trigger(config)
        self._triggers: dict[str, Topic] = {
            topic.key(config.fusion_host): topic for topic in (FUSION_VERDICT, FUSION_HEALTH)
        }
        self._open: tuple[Incident, float] | None = None  # and when it came here

    def process(self, now_s: float, kept: Kept | None) -> Saved | None:
        """Take one arrival (or None: time passes); returns an incident when its window is complete."""
        # Keep it
        if kept is not None:
            self._ring.add(kept)

        # Is it the beginning of an incident?
        incident = self._look(kept) if kept is not None else None
        if incident is not None and self._open is None:
            self._open = (incident, now_s)

        # Has the open one's window passed?
        if self._open is None or now_s - self._open[1] < self._after_s:
            return None
        (incident, at_s), self._open = self._open, None
        return Saved(incident, self._ring.window(at_s - self._before_s, at_s + self._after_s))

    def save(self, now_s: float, incident: Incident) -> Incident:
        """A person asks for it. An incident that is open already goes on, with these words added; returns it."""
        opened, since_s = self._open or (incident, now_s)
        if opened is not incident:
            opened = replace(opened, why=f"{opened.why}; {incident.why}")
        self._open = (opened, since_s)
        return opened

    def _look(self, kept: Kept) -> Incident | None:
        topic = self._triggers.get(kept.key)
        if topic is None:
            return None
        try:
            return self._trigger.see(decode(kept.payload, topic.message, topic.max_bytes))
        except DecodeError:
            return None
