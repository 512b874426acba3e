"""What has to hold over all results: the bars of the proving ground."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from spotter_tools.prove.case import OUT, Outcome
from spotter_tools.prove.ground import Result

ALL_ONLINE, ONE_OUT = 0.97, 0.90  # share of what a perfect sensor avoids
HARD = 0.5  # of the closing speed: an impact has to stay below
BRAKES_PER_HOUR = 1.0
YARD_ALARM = 0.005  # share of the time
OVER_LIMIT_S = 0.0


@dataclass(frozen=True)
class Bar:
    """One demand, and whether it is met."""

    text: str
    found: str
    met: bool


def bars(results: list[Result]) -> list[Bar]:
    """Those that the results say something about."""
    return list(_all(results))


def _all(results: list[Result]) -> Iterator[Bar]:
    dangerous = [one for one in results if one.dangerous and one.yardstick.avoidable]
    online = [one for one in dangerous if one.out == "none" and one.ego]
    if online:
        hits = [one.spotter for one in online if one.spotter.collided]
        share = 1.0 - len(hits) / len(online)
        yield Bar(f"all online: at least {ALL_ONLINE:.0%} avoided", f"{share:.1%}", share >= ALL_ONLINE)
        hard = [hit for hit in hits if hit.impact_mps >= HARD * hit.closing_mps]
        yield Bar("  the rest at less than half of the closing speed", f"{len(hard)} harder", not hard)
    for out in (name for name, faults in OUT.items() if len(faults) == 1):
        chosen = [one.spotter for one in dangerous if one.out == out]
        if chosen:
            share = sum(not one.collided or limited(one) for one in chosen) / len(chosen)
            yield Bar(
                f"without {out}: at least {ONE_OUT:.0%} avoided or limited before", f"{share:.0%}", share >= ONE_OUT
            )
    two_out = [one.spotter for one in results if len(OUT[one.out]) == 2]
    if two_out:
        over_s = sum(one.over_limit_s for one in two_out)
        yield Bar("two sensors out: never faster than max_safe_speed_mps", f"{over_s:.1f} s", over_s <= OVER_LIMIT_S)
    yield from _innocent([one for one in results if not one.dangerous and one.out == "none" and one.ego])


def _innocent(results: list[Result]) -> Iterator[Bar]:
    if not results:
        return
    hours = sum(one.spotter.drive_s for one in results) / 3600.0
    brakes = sum(one.spotter.false_brakes for one in results)
    met = brakes <= max(1.0, BRAKES_PER_HOUR * hours)
    yield Bar("innocent: braked for nothing at most once an hour", f"{brakes} times in {60 * hours:.0f} minutes", met)
    yards = [one.spotter for one in results if one.family == "yard"]
    if yards:
        share = sum(one.false_alarm_s for one in yards) / sum(one.drive_s for one in yards)
        yield Bar(f"yards: alarm under {YARD_ALARM:.1%} of the time", f"{share:.2%}", share < YARD_ALARM)
        imminent_s = sum(one.imminent_s for one in yards)
        yield Bar("  and never IMMINENT", f"{imminent_s:.1f} s", imminent_s == 0.0)


def limited(outcome: Outcome) -> bool:
    """The verdict had already limited the speed below that of the unbraked contact."""
    return outcome.limited_mps is not None and outcome.limited_mps < outcome.closing_mps


def bar_lines(found: list[Bar]) -> Iterator[str]:
    """For people."""
    yield ""
    yield "what has to hold"
    for bar in found:
        yield f"  {'ok  ' if bar.met else 'NOT '} {bar.text:60} {bar.found}"
