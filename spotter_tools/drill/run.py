"""Runs the drills of a plan one after the other and keeps what was measured."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import msgspec

from common.clock import monotonic_s
from common.messages import SystemHealth, Verdict
from common.topics import FUSION_VERDICT
from spotter_tools.drill.fault_plan import Drill, DrillPlan, Expected, shown
from spotter_tools.drill.monitor import Watch
from spotter_tools.drill.rig import System


class Result(msgspec.Struct, kw_only=True):
    """One drill: seconds from the fault, None = not in time."""

    name: str
    ok: bool = False
    skipped: str = ""
    health_s: float | None = None
    health_within_s: float = 0.0
    verdict_s: float | None = None
    verdict_within_s: float = 0.0
    actuator_s: float | None = None
    actuator_within_s: float = 0.0
    recovered_s: float | None = None
    levels: list[str] = []
    problems: list[str] = []


def run_plan(plan: DrillPlan, system: System, watch: Watch) -> Iterator[Result]:
    """Yield the result of every drill as it ends."""
    for drill in plan.drills:
        if not all(system.can(fault) for fault in drill.faults):
            yield Result(name=drill.name, ok=True, skipped="not possible against this system")
            continue
        yield run_drill(drill, plan, system, watch)


def run_drill(drill: Drill, plan: DrillPlan, system: System, watch: Watch) -> Result:
    """In order before, broken, seen in time, healed, in order again."""
    result = Result(
        name=drill.name,
        health_within_s=drill.health_within_s,
        verdict_within_s=drill.verdict_within_s,
        actuator_within_s=drill.actuator_within_s,
    )
    # 1. everything in order before
    for fault in drill.faults:
        system.prepare(fault)
    if _settle(plan.before, watch, plan.ready_within_s) is None:
        result.problems.append(f"not ready before the fault: {_seen(watch)}")
        return result
    if drill.actuator_within_s and _moves(system, plan.ready_within_s) is None:
        result.problems.append("not ready before the fault: the actuator is not at GO")
        return result
    watch.broken_rules.clear()
    try:
        # 2. break it
        broken_s = max([system.inject(fault) for fault in drill.faults])
        # 3. health and verdict in time
        _observe_actuator(drill, system, broken_s, result)
        _observe(drill, watch, broken_s, result)
        time.sleep(max(0.0, broken_s + drill.lasts_s - monotonic_s()))
        result.levels = sorted(watch.levels(broken_s))
    except TimeoutError as error:
        result.problems.append(str(error))
    finally:
        # 4. heal, and everything in order again
        for fault in drill.faults:
            system.heal(fault)
    healed_s = monotonic_s()
    recovered_s = _settle(plan.before, watch, drill.recovery_within_s)
    if recovered_s is not None and drill.actuator_within_s:
        recovered_s = _moves(system, drill.recovery_within_s)
    if recovered_s is None:
        result.problems.append(f"not recovered within {drill.recovery_within_s:g} s: {_seen(watch)}")
    else:
        result.recovered_s = round(max(0.0, recovered_s - healed_s), 3)
    # 5. what may never happen
    result.problems += sorted(set(watch.broken_rules))
    result.problems += [f"{level} was seen" for level in result.levels if level not in drill.allowed]
    result.ok = not result.problems
    return result


def _observe(drill: Drill, watch: Watch, broken_s: float, result: Result) -> None:
    """Fill in the times; a miss is a problem with what was seen instead."""
    expected = drill.expect
    if expected.about_health:
        until_s = broken_s + drill.health_within_s
        found = watch.wait_for(SystemHealth, expected.health_fits, broken_s, until_s)
        result.health_s = _since(found, broken_s, drill.health_within_s)
        if result.health_s is None:
            result.problems.append(f"health: wanted {shown(expected)}, {_seen(watch)}")
    until_s = broken_s + drill.verdict_within_s
    if expected.silent:
        quiet_s = watch.wait_for_silence(FUSION_VERDICT.age_limit_s or 0.25, until_s)
        result.verdict_s = _since((quiet_s, None) if quiet_s else None, broken_s, drill.verdict_within_s)
        if result.verdict_s is None:
            result.problems.append("verdicts kept coming")
        return
    verdict = watch.wait_for(Verdict, expected.verdict_fits, broken_s, until_s)
    result.verdict_s = _since(verdict, broken_s, drill.verdict_within_s)
    if result.verdict_s is None:
        result.problems.append(f"verdict: wanted {shown(expected)}, {_seen(watch)}")


def _observe_actuator(drill: Drill, system: System, broken_s: float, result: Result) -> None:
    """Fill in when the actuator was at STOP, by its own account of the moment."""
    if not drill.actuator_within_s or system.actuator is None:
        return
    stopped_s = system.actuator.wait_for("STOP", broken_s, broken_s + drill.actuator_within_s)
    result.actuator_s = _since((stopped_s, None) if stopped_s else None, broken_s, drill.actuator_within_s)
    if result.actuator_s is None:
        result.problems.append(f"the actuator still does {system.actuator.permission}")


def _moves(system: System, within_s: float) -> float | None:
    """Wait until the actuator is at GO; the time when it was."""
    now_s = monotonic_s()
    return system.actuator.wait_for("GO", now_s, now_s + within_s) if system.actuator else now_s


def _since(found: tuple[float, Any] | None, broken_s: float, within_s: float) -> float | None:
    if found is None or found[0] - broken_s > within_s:
        return None
    return round(found[0] - broken_s, 3)


def _settle(before: Expected, watch: Watch, within_s: float) -> float | None:
    """Wait until health and verdict are in order in messages that come from now on; the time when they were."""
    start_s = monotonic_s()
    health = watch.wait_for(SystemHealth, before.health_fits, start_s, start_s + within_s)
    verdict = watch.wait_for(Verdict, before.verdict_fits, health[0], start_s + within_s) if health else None
    return verdict[0] if verdict else None


def _seen(watch: Watch) -> str:
    health, verdict = watch.newest(SystemHealth), watch.newest(Verdict)
    if health is None or verdict is None:
        return "nothing was seen of fusion"
    states = ", ".join(f"{name} {sensor.state} ({sensor.cause or 'ok'})" for name, sensor in health.sensors.items())
    return f"saw {states}; verdict {verdict.level} by {verdict.rule}"


def report_lines(results: list[Result]) -> Iterator[str]:
    """A table for people: time to health and to verdict, against their deadlines."""
    width = max(len(result.name) for result in results)
    yield f"{'drill':<{width}}  {'health':>15}  {'verdict':>15}  {'actuator':>15}  {'back':>7}  levels"
    for result in results:
        if result.skipped:
            yield f"{result.name:<{width}}  skipped: {result.skipped}"
            continue
        times = [
            _against(result.health_s, result.health_within_s),
            _against(result.verdict_s, result.verdict_within_s),
            _against(result.actuator_s, result.actuator_within_s) if result.actuator_within_s else "",
        ]
        back = "-" if result.recovered_s is None else f"{result.recovered_s:.2f} s"
        levels = " ".join(result.levels)
        yield f"{result.name:<{width}}  {times[0]:>15}  {times[1]:>15}  {times[2]:>15}  {back:>7}  {levels}"
        yield from (f"    MISS: {problem}" for problem in result.problems)
    missed = sum(not result.ok for result in results)
    done = sum(not result.skipped for result in results)
    yield f"{done - missed} of {done} drills passed" + (f", {missed} MISSED" if missed else "")


def _against(took_s: float | None, within_s: float) -> str:
    return f"{'-' if took_s is None else f'{took_s:.2f}'} / {within_s:g} s"
