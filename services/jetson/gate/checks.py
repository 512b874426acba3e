"""Whether a verdict may be acted on: what is wrong with it, or with how it came. Pure."""

from __future__ import annotations

from typing import NamedTuple

from common.messages import Verdict
from services.jetson.gate.config import GateConfig


class Heard(NamedTuple):
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


def fault_of(heard: Heard, config: GateConfig) -> Fault | None:
    """The first reason not to act on what was heard, or None."""
    return _sender_fault(heard, config) or _verdict_fault(heard, config)


def _sender_fault(heard: Heard, config: GateConfig) -> Fault | None:
    fusion = f"{config.fusion_host}/fusion"
    if heard.actuator_lost:
        return Fault("actuator_lost", heard.actuator_lost)
    if heard.isolated:
        return Fault("isolated", "the gate has lost its own link to the network")
    if not heard.claimants:
        return Fault("fusion_gone", f"{fusion} has no liveliness token: the process is not there")
    if len(heard.claimants) > 1:
        return Fault("two_claimants", f"{len(heard.claimants)} processes claim {fusion}")
    if heard.two_senders:
        return Fault("two_senders", f"sequence numbers go back and forth: somebody else sends as {fusion}")
    return None


def _verdict_fault(heard: Heard, config: GateConfig) -> Fault | None:
    limits, verdict = config.limits, heard.verdict
    if heard.refused:
        return Fault("unreadable", heard.refused)
    if verdict is None:
        return Fault("starting", "no verdict yet")
    if heard.age_s > limits.verdict_age_s:
        return Fault("stale", f"the verdict is {heard.age_s:.2f} s old, allowed {limits.verdict_age_s:g} s")
    if heard.age_s < -limits.future_s:
        return Fault("clock", f"the verdict is stamped {-heard.age_s:.2f} s ahead of this host's clock")
    if verdict.source_kind not in config.accept:
        origin = "data of unknown origin" if verdict.source_kind == "unknown" else f"{verdict.source_kind} data"
        return Fault("not_live", f"the verdict rests on {origin}; accepted: {', '.join(config.accept) or 'none'}")
    return None
