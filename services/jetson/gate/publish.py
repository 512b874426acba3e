"""The gate's own word on the bus: at once after a change, and ten times a second."""

from __future__ import annotations

from collections.abc import Sequence

from common.messages import GateState, Verdict
from common.periodic import Periodic
from services.jetson.gate.config import GateConfig
from services.jetson.gate.output import Output
from services.jetson.gate.pipeline import Decision

STATE_PERIOD_S = 0.1


class StateNews:
    """``news`` gives the message when there is something new or the period is over, else None."""

    def __init__(self, config: GateConfig) -> None:
        self._config = config
        self._timer = Periodic(STATE_PERIOD_S)
        self._last: tuple[object, ...] = ()

    def news(
        self, now_s: float, now_ns: int, decision: Decision, verdict: Verdict | None, outputs: Sequence[Output]
    ) -> GateState | None:
        """The state of the gate at ``now_s`` (monotonic), ``now_ns`` (UTC)."""
        key = (decision.permission, decision.limit_mps, decision.cause, decision.acknowledge)
        if key == self._last and not self._timer.due(now_s):
            return None
        self._last = key
        impaired = self._impaired(now_s, outputs)
        return GateState(
            stamp_ns=now_ns,
            frame_id="vehicle",
            state="degraded" if impaired else "online",
            reason=impaired,
            permission=decision.permission,
            limit_mps=decision.limit_mps,
            cause=decision.cause,
            because=decision.because,
            left_s=decision.left_s,
            acknowledge=decision.acknowledge,
            verdict_seq=verdict.seq if verdict else None,
            verdict_age_s=None if verdict is None else max(0.0, (now_ns - verdict.stamp_ns) * 1e-9),
            outputs={str(output.url): output.fault(now_s) or output.words() or "open" for output in outputs},
            source_kind=verdict.source_kind if verdict else "unknown",
        )

    def _impaired(self, now_s: float, outputs: Sequence[Output]) -> str:
        if not outputs:
            return "no output is configured: nothing acts on the permission (`outputs` in gate.toml)"
        faults = [fault for output in outputs if (fault := output.fault(now_s))]
        if faults:
            return "; ".join(faults)
        others = [kind for kind in self._config.accept if kind != "live"]
        real = [str(output.url) for output in outputs if output.url.scheme != "sim"]
        if others and real:
            return f"acts on {' and '.join(others)} data on {', '.join(real)}: for tests only (`accept` in gate.toml)"
        return ""
