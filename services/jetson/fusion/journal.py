"""The same record in the log: one line whenever the verdict's level or a sensor's state changes."""

from __future__ import annotations

import logging

from common.messages import SystemHealth, Verdict
from common.topics import spoken

log = logging.getLogger("verdict")


class Journal:
    """Remembers what was logged last."""

    def __init__(self) -> None:
        self._verdict: tuple[str, str] | None = None
        self._sensors: dict[str, tuple[str, str]] = {}

    def note_verdict(self, verdict: Verdict) -> None:
        """Log a change of level or permission, with the rule, the reason and the way down."""
        noted = (verdict.level, verdict.permission)
        if noted == self._verdict:
            return
        self._verdict = noted
        way_down = f"; lower when: {verdict.to_lower}" if verdict.to_lower else ""
        log.info("%s -> %s by %s: %s%s", verdict.level, verdict.permission, verdict.rule, verdict.because, way_down)

    def note_health(self, health: SystemHealth) -> None:
        """Log a change of a sensor's state or cause; recovering is not worth a line."""
        for name, sensor in health.sensors.items():
            noted = (sensor.state, sensor.cause)
            if noted == self._sensors.get(name) or sensor.cause == "recovering":
                continue
            self._sensors[name] = noted
            why = f": {sensor.reason}" if sensor.reason else ""
            log.log(
                logging.INFO if sensor.state == "online" else logging.WARNING,
                "%s %s%s",
                spoken(name),
                sensor.state,
                why,
            )
