"""A verdict's inputs as a message, and the way back: what was decided once can be decided again, anywhere."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from common.messages import FusionTrace, Verdict
from services.jetson.fusion.config import RulesConfig
from services.jetson.fusion.evidence import FusionInputs, FusionMemory
from services.jetson.fusion.verdict import fuse

if TYPE_CHECKING:
    from services.jetson.fusion.pipeline import Step


def trace_of(step: Step, verdict: Verdict, rules: RulesConfig) -> FusionTrace:
    """The trace of a verdict that has just been published."""
    return FusionTrace(
        stamp_ns=verdict.stamp_ns,
        frame_id=verdict.frame_id,
        verdict_seq=verdict.seq,
        inputs=msgspec.to_builtins(step.inputs),
        memory=msgspec.to_builtins(step.memory),
        rules=msgspec.to_builtins(rules),
    )


def inputs_of(trace: FusionTrace) -> FusionInputs:
    """Raises ``msgspec.ValidationError`` when the trace is not one of ours."""
    return msgspec.convert(trace.inputs, FusionInputs)


def memory_of(trace: FusionTrace) -> FusionMemory:
    """The memory before the verdict; raises ``msgspec.ValidationError``."""
    return msgspec.convert(trace.memory, FusionMemory)


def decide_again(trace: FusionTrace) -> tuple[Verdict, FusionMemory]:
    """The verdict and the memory after it, from the trace alone; raises ``msgspec.ValidationError``."""
    return fuse(inputs_of(trace), memory_of(trace), msgspec.convert(trace.rules, RulesConfig))
