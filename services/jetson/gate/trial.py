"""The wiring on trial, wheels off the ground: STOP, SLOW, GO, then silence, and what the actuator answers."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

from common.clock import monotonic_s
from services.jetson.gate.config import GateConfig
from services.jetson.gate.frames import FRAMES_STOPPED
from services.jetson.gate.output import Output
from services.jetson.gate.pipeline import STOPPED, Decision

ROUND_S = 0.01
STEADY_S = 1.5  # the firmware wants a second of frames first
SILENCE_S = 0.6
PATIENCE_S = 3.0  # for an actuator that does not do at once what it is told


class Step(NamedTuple):
    """What is sent for how long (None: nothing at all), and what has to be seen."""

    name: str
    decision: Decision | None
    seconds: float
    look: str


class Finding(NamedTuple):
    """One step's outcome. ``after_s``: until the actuator said that it does so; None when it never did."""

    name: str
    look: str
    words: str
    after_s: float | None
    fault: str


def steps_of(config: GateConfig, seconds: float) -> tuple[Step, ...]:
    """The steps, each move for ``seconds``."""
    speed, valid_s = config.speed, config.limits.permit_s
    slow = Decision("SLOW", speed.slow_mps, valid_s, "trial", "wheels up")
    go = Decision("GO", speed.go_mps, valid_s, "trial", "wheels up")
    return (
        Step("STOP", STOPPED, STEADY_S, "give throttle: the wheels stand still"),
        Step("SLOW", slow, seconds, f"give full throttle: the wheels turn at {speed.slow_mps:g} m/s at most"),
        Step("STOP", STOPPED, 0.5, "the wheels stop at once"),
        Step("GO", go, seconds, f"the wheels turn, up to {speed.go_mps:g} m/s"),
        Step("silence", None, SILENCE_S, "as if this computer had died: the wheels stop by themselves"),
        Step("STOP", STOPPED, 0.5, "the wheels stay where they are, whatever the throttle"),
    )


def trial(output: Output, steps: tuple[Step, ...], show: Callable[[Step], None]) -> Iterator[Finding]:
    """Go through the steps with one output, which is closed (STOP) at the end; ``show`` is called before each."""
    try:
        for step in steps:
            show(step)
            finding = _run(output, step)
            yield finding
            if finding.fault and not finding.words:
                return  # there is no actuator: nothing further to see
    finally:
        output.close()


def _run(output: Output, step: Step) -> Finding:
    wanted = "STOP" if step.decision is None else step.decision.permission
    start_s, after_s, words = monotonic_s(), None, ""
    while (now_s := monotonic_s()) < start_s + step.seconds + (0.0 if after_s or not output.words() else PATIENCE_S):
        if step.decision is None:
            output.listen(now_s)
        else:
            output.send(now_s, step.decision, 0)
        if after_s is None and _does(output.words(), wanted, silent=step.decision is None):
            after_s, words = monotonic_s() - start_s, output.words()
        time.sleep(ROUND_S)
    fault = "" if after_s is not None else output.fault(monotonic_s())
    return Finding(step.name, step.look, words or output.words(), after_s, fault)


def _does(words: str, wanted: str, *, silent: bool) -> bool:
    """Whether the actuator says that it does what it should; in silence it has to have stopped by itself."""
    return words.startswith(f"STOP ({FRAMES_STOPPED})") if silent else words.startswith(wanted)
