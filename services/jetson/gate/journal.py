"""The log of the gate: one line whenever the permission or its cause changes."""

from __future__ import annotations

import logging

from services.jetson.gate.pipeline import Decision

log = logging.getLogger("gate")


class Journal:
    """Remembers what was logged last."""

    def __init__(self) -> None:
        self._noted: tuple[str, str] | None = None

    def note(self, decision: Decision) -> None:
        """Log a change, with the reason."""
        noted = (decision.permission, decision.cause)
        if noted == self._noted:
            return
        self._noted = noted
        limit = f", at most {decision.limit_mps:g} m/s" if decision.permission != "STOP" else ""
        log.info("%s%s (%s): %s", decision.permission, limit, decision.cause, decision.because)
