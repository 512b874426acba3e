"""The results for people: one table, Spotter beside the article's rules, and what went wrong."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from spotter_tools.prove.bars import bar_lines, bars, limited
from spotter_tools.prove.case import OUT, Outcome
from spotter_tools.prove.ground import Result

_WIDTH = 34


def lines(results: list[Result]) -> Iterator[str]:
    """The whole report."""
    dangerous = [one for one in results if one.dangerous and one.yardstick.avoidable]
    beyond = sum(one.dangerous and not one.yardstick.avoidable for one in results)
    yield f"{len(results)} cases, {sum(one.dangerous for one in results)} of them dangerous."
    yield "Yardstick: a perfect sensor with 0.1 s reaction and the same brakes " + (
        f"cannot avoid {beyond}; those do not count below." if beyond else "avoids all of them."
    )
    yield ""
    yield f"{'dangerous: avoided, of':{_WIDTH}} {'cases':>5}   {'Spotter':<34}   the article's rules"
    for name, chosen in _groups(dangerous):
        if chosen:
            yield _row(name, chosen, _avoided)
    yield ""
    yield f"{'innocent':{_WIDTH}} {'cases':>5}   {'Spotter':<34}   the article's rules"
    innocent = [one for one in results if not one.dangerous]
    for name, chosen in _innocent_groups(innocent):
        if chosen:
            yield _row(name, chosen, _disturbed)
    yield from _families(dangerous)
    yield from bar_lines(bars(results))
    yield from _failures(results)


def _row(name: str, chosen: list[Result], words: Callable[[list[Result], str], str]) -> str:
    return f"{name:{_WIDTH}} {len(chosen):>5}   {words(chosen, 'spotter'):<34}   {words(chosen, 'article')}"


def _groups(results: list[Result]) -> Iterator[tuple[str, list[Result]]]:
    online = [one for one in results if one.out == "none" and one.ego]
    yield "all sensors online", online
    for preset in ("model", "cart"):
        yield f"  {preset}", [one for one in online if one.preset == preset]
    for tag in ("dusk", "rain"):
        yield f"  {tag}", [one for one in online if tag in one.tags]
    yield "one sensor out", [one for one in results if len(OUT[one.out]) == 1]
    for out in (name for name, faults in OUT.items() if len(faults) == 1):
        yield f"  without {out}", [one for one in results if one.out == out]
    yield "two sensors out", [one for one in results if len(OUT[one.out]) == 2]
    yield "motion unknown", [one for one in results if not one.ego]


def _innocent_groups(results: list[Result]) -> Iterator[tuple[str, list[Result]]]:
    online = [one for one in results if one.out == "none" and one.ego]
    yield "all sensors online", online
    yield "  yards", [one for one in online if one.family == "yard"]
    for tag in ("dusk", "rain"):
        yield f"  {tag}", [one for one in online if tag in one.tags]
    yield "one sensor out", [one for one in results if len(OUT[one.out]) == 1]
    yield "motion unknown", [one for one in results if not one.ego]


def outcome(result: Result, who: str) -> Outcome:
    """Of ``spotter`` or ``article``."""
    found: Outcome = getattr(result, who)
    return found


def _avoided(chosen: list[Result], who: str) -> str:
    """How many were avoided, how hard the rest was, and how many of those were slowed in advance."""
    hits = [outcome(one, who) for one in chosen if outcome(one, who).collided]
    text = f"{len(chosen) - len(hits)} ({1 - len(hits) / len(chosen):.0%})"
    if not hits:
        return text
    hard = sum(hit.impact_mps > 0.5 * hit.closing_mps for hit in hits)
    return f"{text}; hard {hard}, limited before {sum(map(limited, hits))}"


def _disturbed(chosen: list[Result], who: str) -> str:
    """Share of the time in alarm, and how often it braked for nothing."""
    outcomes = [outcome(one, who) for one in chosen]
    hours = sum(one.drive_s for one in outcomes) / 3600.0
    share = sum(one.false_alarm_s for one in outcomes) / (3600.0 * hours)
    brakes = sum(one.false_brakes for one in outcomes) / hours
    return f"alarm {share:.1%}, IMMINENT {sum(one.imminent_s for one in outcomes):.1f} s, brakes {brakes:.0f}/h"


def _families(dangerous: list[Result]) -> Iterator[str]:
    yield ""
    yield f"{'by family, all online':{_WIDTH}} {'cases':>5}"
    online = [one for one in dangerous if one.out == "none" and one.ego]
    for family in sorted({one.family for one in online}):
        yield _row(f"  {family}", [one for one in online if one.family == family], _avoided)


def _failures(results: list[Result]) -> Iterator[str]:
    failed = [one for one in results if one.failed]
    yield ""
    yield f"{len(failed)} cases failed" + (":" if failed else ".")
    for one in failed:
        yield f"  {one.name}: {sentence(one)}"


def sentence(result: Result) -> str:
    """What went wrong in a failed case."""
    found = result.spotter
    if found.collided and result.dangerous:
        warned = "no alarm before it" if found.first_caution_s is None else f"alarm {_lead(result):.1f} s before it"
        return f"hit at {found.impact_mps:.1f} of {found.closing_mps:.1f} m/s, {warned}"
    if found.collided:
        return f"hit something at {found.impact_mps:.1f} m/s that stood beside its way"
    return (
        f"{found.false_alarm_s:.1f} s of alarm ({found.imminent_s:.1f} s IMMINENT), braked {found.false_brakes} times"
    )


def _lead(result: Result) -> float:
    """From the first alarm to the end of the drive."""
    first_s = result.spotter.first_caution_s
    return 0.0 if first_s is None else result.spotter.drive_s - first_s
