"""The options of a swap, and its outcome."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import msgspec

from spotter_tools.swap.compare import Comparison, Limits
from spotter_tools.swap.watch import Gap


@dataclass(frozen=True)
class Order:
    """The command line of ``spotter swap``."""

    service: str
    host: str
    candidate: str
    seconds: float
    probation_s: float
    limits: Limits
    connect: str
    namespace: str
    stop_command: str
    start_command: str
    log: Path
    dry_run: bool


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """How the swap ended; ``reasons`` are those of a refusal, or notes on a promotion."""

    promoted: bool
    reasons: tuple[str, ...] = ()
    comparison: Comparison | None = None
    switchover: Gap | None = None
    old: str = ""
    new: str = ""
    pid: int | None = None
    supervised: bool = False  # by the supervisor that had started the old one


class Refused(Exception):
    """The swap is refused; with ``comparison`` if it got that far."""

    def __init__(self, *reasons: str, comparison: Comparison | None = None) -> None:
        super().__init__("; ".join(reasons))
        self.reasons, self.comparison = reasons, comparison
