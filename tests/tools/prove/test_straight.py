"""Straight drives through all sensors and fusion, nobody brakes: what the verdict says, and when."""

from __future__ import annotations

import heapq

import pytest

from common.messages import LEVELS, Verdict
from spotter_sim.model import Scenario
from spotter_sim.straight import box_ahead, parked_lane
from spotter_tools.prove.configs import configs_of
from spotter_tools.prove.deciders import Spotter
from spotter_tools.prove.senses import Arrival, Senses

PERIOD_S = 0.05
SETTLED_S = 2.5
BUMPER_M = 0.2


def verdicts(scenario: Scenario, seconds: float, *, ego: bool = True) -> list[tuple[float, Verdict]]:
    """Verdicts with the place of the bumper, once all sensors have settled."""
    configs = configs_of("model")
    senses, spotter = Senses(scenario, configs, ego=ego), Spotter(configs)
    due_s, waiting, decisions = dict(senses.periods), list[tuple[float, int, Arrival]](), []
    for step in range(round(seconds / PERIOD_S)):
        now_s = step * PERIOD_S
        while min(due_s.values()) <= now_s:
            name = min(due_s, key=lambda one: due_s[one])
            for arrival in senses.measure(name, due_s[name]):
                heapq.heappush(waiting, (arrival.at_s, len(decisions) * 1000 + len(waiting), arrival))
            due_s[name] += senses.periods[name]
        while waiting and waiting[0][0] <= now_s:
            spotter.take(heapq.heappop(waiting)[2])
        verdict = spotter.decide(now_s)
        if now_s >= SETTLED_S:
            decisions.append((float(scenario.at(now_s).T_map_vehicle[0, 3]) + BUMPER_M, verdict))
    return decisions


@pytest.mark.slow
def test_a_lane_of_parked_cars_is_safe_and_seen_all_the_way() -> None:
    decisions = verdicts(parked_lane(2.0), 8.5)
    assert {verdict.level for _, verdict in decisions} == {"SAFE"}
    driving = [verdict for _, verdict in decisions if verdict.way is not None and verdict.way.motion == "driving"]
    assert len(driving) > 100
    assert all(v.covered_m is not None and v.way is not None and v.covered_m > v.way.stopping_m for v in driving)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("speed_mps", "at_m", "caution_m", "imminent_m"),
    [(1.0, 5.0, 2.9, 1.4), (2.0, 7.0, 4.9, 2.9), (3.0, 10.5, 4.4, 4.4)],
)
def test_a_box_is_cautioned_of_and_then_imminent(
    speed_mps: float, at_m: float, caution_m: float, imminent_m: float
) -> None:
    """No later than by the article's rules, which at 3 m/s have no CAUTION before."""
    decisions = verdicts(box_ahead(speed_mps, at_m), 3.0 + at_m / speed_mps)
    first = {
        level: next(at_m - x_m for x_m, verdict in decisions if verdict.level == level)
        for level in ("CAUTION", "IMMINENT")
    }
    assert first["CAUTION"] >= caution_m
    assert first["CAUTION"] > first["IMMINENT"] >= imminent_m
    ranks = [LEVELS.index(verdict.level) for x_m, verdict in decisions if x_m < at_m]
    assert ranks == sorted(ranks)
