"""What is an incident: a rise of the verdict, a sensor that changes its state, a person's wish. Pure.

Every blackbox sees the same verdict and health messages, so every host finds the same incidents with the same names.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime

from common.messages import LEVELS, Level, Message, SensorState, SystemHealth, Verdict
from services.blackbox.config import BlackboxConfig

NAME = re.compile(r"^\d{8}T\d{6}\.\d{3}Z-[a-z0-9-]{1,60}$")  # a name from the network becomes a folder: nothing else


@dataclass(frozen=True)
class Incident:
    """``name`` is the same on every host; ``at_ns`` is the stamp of the message that showed it."""

    name: str
    at_ns: int
    why: str


def incident_name(at_ns: int, what: str) -> str:
    """``20260314T091502.250Z-imminent``: when, by fusion's clock, and what."""
    at = datetime.fromtimestamp(at_ns / 1e9, UTC)
    slug = re.sub(r"[^a-z0-9]+", "-", what.lower()).strip("-")[:60]
    return f"{at:%Y%m%dT%H%M%S}.{at.microsecond // 1000:03d}Z-{slug or 'saved'}"


class Trigger:
    """Feed it every verdict and health message of the fusion host."""

    def __init__(self, config: BlackboxConfig) -> None:
        self._config = config
        self._level: Level | None = None
        self._states: dict[str, SensorState] = {}

    def see(self, message: Message) -> Incident | None:
        """The incident that this message shows, if any. The first message only tells how things are."""
        if isinstance(message, Verdict):
            return self._see_verdict(message)
        if isinstance(message, SystemHealth):
            return self._see_health(message)
        return None

    def _see_verdict(self, verdict: Verdict) -> Incident | None:
        before, self._level = self._level, verdict.level
        if before is None or LEVELS.index(verdict.level) <= LEVELS.index(before):
            return None
        if verdict.level == "CAUTION" and not self._config.on_caution:
            return None
        why = f"{verdict.level} ({verdict.rule}): {verdict.because}"
        return Incident(incident_name(verdict.stamp_ns, verdict.level), verdict.stamp_ns, why)

    def _see_health(self, system: SystemHealth) -> Incident | None:
        states = {name: sensor.state for name, sensor in system.sensors.items()}
        before, self._states = self._states, states
        changed = [name for name, state in states.items() if before.get(name, state) != state]
        if not changed or not self._config.on_health_change:
            return None
        name = changed[0]
        why = f"{name} {states[name]}: {system.sensors[name].reason}".removesuffix(": ")  # online needs no reason
        return Incident(incident_name(system.stamp_ns, f"{name}-{states[name]}"), system.stamp_ns, why)
