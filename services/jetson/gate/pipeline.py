"""From verdict to permission: a state machine that needs nothing to stop and a good while to start. Pure.

Rules, in this order:

1. Anything wrong with the verdict, its sender or the gate's own loop is STOP at once (``checks``).
2. STOP and SLOW from fusion count at once.
3. After a STOP, good verdicts without a break for ``release.after_stop_s``, and a person's word where configured.
4. A speed limit is lifted after GO without a break for ``release.speed_up_s``.
5. While the vehicle drives the limit is at most the speed from which it stops within what fusion sees.
6. A permission ends by itself when its verdict gets too old: ``valid_s`` goes to the actuator with it.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

from common.messages import Verdict
from services.jetson.gate.checks import Fault, GateInputs, fault_of
from services.jetson.gate.config import GateConfig

Permission = Literal["GO", "SLOW", "STOP"]


class Decision(NamedTuple):
    """What goes to the actuator, and why."""

    permission: Permission
    limit_mps: float  # 0 with STOP
    valid_s: float  # the permission ends by itself after this; 0 with STOP
    cause: str  # "verdict", or the fault that stops, or "waiting", "acknowledge"
    because: str
    left_s: float = 0.0  # of good verdicts until it may move again
    acknowledge: bool = False  # a person has to say so first


STOPPED = Decision("STOP", 0.0, 0.0, "starting", "the gate has just started")


class GatePipeline:
    """``process`` at every round of the loop and at every verdict. Times are monotonic seconds, given by the caller."""

    def __init__(self, config: GateConfig) -> None:
        self._config = config
        self._given: Permission = "STOP"
        self._good_since_s: float | None = None  # nothing has said STOP since then
        self._go_since_s: float | None = None  # fusion has said GO since then
        self._needs_acknowledge = config.release.acknowledge != "never"
        self._last_s: float | None = None

    def process(self, now_s: float, inputs: GateInputs) -> Decision:
        """The permission at ``now_s``."""
        fault = self._overrun(now_s) or fault_of(inputs, self._config)
        self._last_s = now_s
        if fault is not None:
            return self._stop(fault, by_fault=True)
        assert inputs.verdict is not None  # fault_of has refused that
        if inputs.verdict.permission == "STOP":
            return self._stop(Fault("verdict", inputs.verdict.because), by_fault=False)
        self._note_good(now_s, inputs)
        waiting = self._waiting(now_s) if self._given == "STOP" else None
        if waiting is not None:
            return waiting
        self._given = self._allowed(now_s, inputs.verdict.permission)
        return self._moving(inputs, inputs.verdict.because)

    def _overrun(self, now_s: float) -> Fault | None:
        """The gate itself was away: whatever it said in the meantime was not checked."""
        if self._last_s is None or now_s - self._last_s <= self._config.limits.overrun_s:
            return None
        return Fault("overrun", f"the gate's own loop stood still for {now_s - self._last_s:.2f} s")

    def _stop(self, fault: Fault, *, by_fault: bool) -> Decision:
        wanted = self._config.release.acknowledge
        self._given, self._good_since_s, self._go_since_s = "STOP", None, None
        self._needs_acknowledge |= wanted == "after_stop" or (wanted == "after_fault" and by_fault)
        after_s = self._config.release.after_stop_s
        return Decision("STOP", 0.0, 0.0, fault.cause, fault.because, after_s, self._needs_acknowledge)

    def _note_good(self, now_s: float, inputs: GateInputs) -> None:
        assert inputs.verdict is not None
        if self._good_since_s is None:
            self._good_since_s = now_s
        if inputs.verdict.permission != "GO":
            self._go_since_s = None
        elif self._go_since_s is None:
            self._go_since_s = now_s
        if inputs.acknowledged:  # counts only now, while nothing says STOP: never in advance
            self._needs_acknowledge = False

    def _waiting(self, now_s: float) -> Decision | None:
        assert self._good_since_s is not None
        left_s = self._good_since_s + self._config.release.after_stop_s - now_s
        if left_s > 0.0:
            text = f"good verdicts again, for {left_s:.1f} s more before the vehicle may move"
            return Decision("STOP", 0.0, 0.0, "waiting", text, left_s, self._needs_acknowledge)
        if self._needs_acknowledge:
            text = "a person has to acknowledge: `spotter gate acknowledge`, or the button"
            return Decision("STOP", 0.0, 0.0, "acknowledge", text, 0.0, True)
        return None

    def _allowed(self, now_s: float, wanted: Permission) -> Permission:
        if wanted != "GO" or self._go_since_s is None:
            return "SLOW"
        long_enough = now_s - self._go_since_s >= self._config.release.speed_up_s
        return "GO" if long_enough or self._given == "GO" else "SLOW"

    def _moving(self, inputs: GateInputs, because: str) -> Decision:
        limits = self._config.limits
        limit_mps = self._limit_mps(inputs.verdict)
        valid_s = min(limits.permit_s, limits.verdict_age_s - max(0.0, inputs.age_s))
        return Decision(self._given, limit_mps, valid_s, "verdict", because)

    def _limit_mps(self, verdict: Verdict | None) -> float:
        """The configured limit, and while the vehicle drives what fusion says is safe.

        A vehicle that stands is not held to that: some sensors see standing things only while it drives.
        """
        speed = self._config.speed
        limit_mps = speed.go_mps if self._given == "GO" else speed.slow_mps
        driving = verdict is not None and verdict.way is not None and verdict.way.motion == "driving"
        if not speed.keep_safe or verdict is None or not driving or verdict.max_safe_speed_mps is None:
            return limit_mps
        return min(limit_mps, verdict.max_safe_speed_mps)
