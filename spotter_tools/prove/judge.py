"""The log of a drive to its outcome."""

from __future__ import annotations

from itertools import pairwise

from spotter_tools.prove.case import BEGINS_S, Outcome
from spotter_tools.prove.loop import WATCH_S, Drive, Moment
from spotter_tools.prove.yardstick import Yardstick

TRUE_WITHIN_S = 4.0  # an alarm is true from so long before the unbraked contact on
BEFORE_S = 1.0  # "had already limited the speed": so long before the unbraked contact
OVER_MPS = 0.1
_STANDS_MPS = 0.02


def judge(drive: Drive, yardstick: Yardstick) -> Outcome:
    """What came of it; times count from ``BEGINS_S``."""
    log = [moment for moment in drive.log if moment.t_s >= BEGINS_S]
    alarms = [moment for moment in log if _level(moment) != "SAFE"]
    false = [moment for moment in alarms if not _is_true(moment.t_s, yardstick)]
    return Outcome(
        collided=drive.impact_mps is not None,
        impact_mps=drive.impact_mps or 0.0,
        min_gap_m=max(0.0, min(moment.gap_m for moment in log)),
        first_caution_s=_first(log, lambda moment: _level(moment) != "SAFE"),
        first_imminent_s=_first(log, lambda moment: _level(moment) == "IMMINENT"),
        stopped_s=_first(log, lambda moment: moment.speed_mps < _STANDS_MPS < moment.planned_mps),
        alarm_s=round(len(alarms) * WATCH_S, 3),
        false_alarm_s=round(len(false) * WATCH_S, 3),
        imminent_s=round(sum(_level(moment) == "IMMINENT" for moment in log) * WATCH_S, 3),
        drive_s=round(len(log) * WATCH_S, 3),
        false_brakes=sum(b.braking and not a.braking and not _is_true(b.t_s, yardstick) for a, b in pairwise(log)),
        closing_mps=yardstick.closing_mps,
        limited_mps=_limit_before(log, yardstick),
        over_limit_s=round(sum(_over(moment) for moment in log) * WATCH_S, 3),
    )


def _level(moment: Moment) -> str:
    return "SAFE" if moment.verdict is None else moment.verdict.level


def _is_true(t_s: float, yardstick: Yardstick) -> bool:
    return yardstick.contact_s is not None and t_s >= yardstick.contact_s - TRUE_WITHIN_S


def _first(log: list[Moment], holds: object) -> float | None:
    assert callable(holds)
    return next((round(moment.t_s - BEGINS_S, 3) for moment in log if holds(moment)), None)


def _limit_before(log: list[Moment], yardstick: Yardstick) -> float | None:
    """The speed limit in force when a perfect sensor knew, or a second before the contact, whichever came first."""
    if yardstick.contact_s is None:
        return None
    at_s = min(yardstick.contact_s - BEFORE_S, yardstick.known_s or yardstick.contact_s)
    before = [moment for moment in log if moment.t_s <= max(at_s, BEGINS_S) and moment.decision is not None]
    return before[-1].decision.limit_mps if before and before[-1].decision else None


def _over(moment: Moment) -> bool:
    """Faster than the verdict says is safe, and not braking."""
    safe_mps = getattr(moment.verdict, "max_safe_speed_mps", None)
    return safe_mps is not None and moment.speed_mps > safe_mps + OVER_MPS and not moment.braking
