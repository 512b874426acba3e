"""Whether a verdict may be acted on: what is wrong with it, or with how it came. Pure."""

from __future__ import annotations

from typing import NamedTuple

from common.messages import Verdict
from services.jetson.gate.config import GateConfig


class GateInputs(NamedTuple):
    """All that the gate knows at one moment.

    ``age_s`` is since fusion stamped the verdict, negative when it is stamped ahead of our clock. ``refused`` says what
    was wrong with a message on fusion's key that came since the last verdict which could be read; ``claimants`` are the
    processes that say they are fusion, by their liveliness tokens.
    """

    verdict: Verdict | None = None
    age_s: float = 0.0
    claimants: tuple[str, ...] = ()
    isolated: bool = False
    refused: str = ""
    two_senders: bool = False
    actuator_lost: str = ""
    acknowledged: bool = False  # by a person, since the last call


class Fault(NamedTuple):
    """Why the gate stops although fusion did not say so."""

    cause: str
    because: str


def fault_of(inputs: GateInputs, config: GateConfig) -> Fault | None:
    """The first reason not to act on the verdict, or None."""
    return _sender_fault(inputs, config) or _verdict_fault(inputs, config)


def _sender_fault(inputs: GateInputs, config: GateConfig) -> Fault | None:
    fusion = f"{config.fusion_host}/fusion"
    if inputs.actuator_lost:
        return Fault("actuator_lost", inputs.actuator_lost)
    if inputs.isolated:
        return Fault("isolated", "the gate has lost its own link to the network")
    if not inputs.claimants:
        return Fault("fusion_gone", f"{fusion} has no liveliness token: it has ended, hangs, or cannot be reached")
    if len(inputs.claimants) > 1:
        return Fault("two_claimants", f"{len(inputs.claimants)} processes claim {fusion}")
    if inputs.two_senders:
        return Fault("two_senders", f"sequence numbers go back and forth: somebody else sends as {fusion}")
    return None


def _verdict_fault(inputs: GateInputs, config: GateConfig) -> Fault | None:
    limits, verdict = config.limits, inputs.verdict
    if inputs.refused:
        return Fault("unreadable", inputs.refused)
    if verdict is None:
        return Fault("starting", "no verdict yet")
    if inputs.age_s > limits.verdict_age_s:
        return Fault("stale", f"the verdict is {inputs.age_s:.2f} s old, allowed {limits.verdict_age_s:g} s")
    if inputs.age_s < -limits.future_s:
        return Fault("clock", f"the verdict is stamped {-inputs.age_s:.2f} s ahead of this host's clock")
    if verdict.source_kind not in config.accept:
        origin = "data of unknown origin" if verdict.source_kind == "unknown" else f"{verdict.source_kind} data"
        return Fault("not_live", f"the verdict rests on {origin}; accepted: {', '.join(config.accept) or 'none'}")
    return None
