"""What fusion sees of the world at one moment: everything that arrived, who is there, and the time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from common.bus.presence import Instance
from common.bus.pubsub import Received
from common.messages import LinkFault
from services.jetson.fusion.clocks import ClockSample


@dataclass(frozen=True, slots=True)
class Observation:
    """One step's input. Recorded observations replayed through a new pipeline give the same verdicts."""

    now_s: float  # monotonic
    now_ns: int  # UTC
    received: tuple[Received[Any], ...] = ()
    present: frozenset[Instance] = frozenset()
    isolated: bool = False  # our own session has no link
    clock_samples: tuple[ClockSample, ...] = ()
    link_faults: Mapping[str, LinkFault] = field(default_factory=dict)  # by host: why our router cannot link it
    acknowledged: bool = False  # a person has looked: what no sensor sees now is gone
    refused: dict[str, str] = field(default_factory=dict)  # by key: why a payload that came now was refused
