"""One drive, closed loop, in simulated time: sensors, pipelines, verdict, gate, brakes, motion. No clock, no process.

Events in the order of their time: a sensor is asked, a message arrives, a verdict or a permission is due, an order
reaches the brakes. Between two events the vehicle drives on under the order in force. Deterministic by the case's seed.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Any

from common.messages import Verdict
from services.jetson.gate.checks import GateInputs
from services.jetson.gate.pipeline import Decision, GatePipeline
from spotter_sim.contact import contact_s, gap_m
from spotter_sim.model import Scenario
from spotter_tools.prove.braked import FREE, Braked, Order
from spotter_tools.prove.case import BEGINS_S, PRESETS, Case
from spotter_tools.prove.configs import Configs, configs_of
from spotter_tools.prove.deciders import DECIDERS, Decider
from spotter_tools.prove.senses import Arrival, Senses

VERDICT_TO_GATE_S, GATE_TO_ACTUATOR_S = 0.003, 0.005
WATCH_S = 0.02
RESTS_S = 1.5  # having stood for so long, the vehicle will not come nearer
LOOK_S, AHEAD_S, OVERTIME_S = 0.5, 8.0, 16.0  # a slow vehicle is given time to arrive at what is in its way


@dataclass(frozen=True)
class Moment:
    """A line of the log of a drive."""

    t_s: float
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    planned_mps: float
    gap_m: float
    verdict: Verdict | None
    decision: Decision | None
    braking: bool


@dataclass
class Drive:
    """The log of a drive, one ``Moment`` every ``WATCH_S``, and the world in which it took place."""

    case: Case
    scenario: Scenario
    log: list[Moment] = field(default_factory=list)
    impact_mps: float | None = None


def moving_world(case: Case) -> tuple[Scenario, Braked]:
    """The case's world with a vehicle that can be braked, its devices failing as the case says."""
    assert case.scenario.vehicle is not None
    vehicle = Braked(case.scenario.vehicle, PRESETS[case.preset])
    name = f"{case.name}#{case.seed}"  # noise depends on it
    faults = (*case.scenario.faults, *case.faults)
    return replace(case.scenario, name=name, vehicle=vehicle, faults=faults, length_s=case.ends_s + 100.0), vehicle


def drive(case: Case, decider: str = "spotter") -> Drive:
    """Drive the case to its end, to a collision, or until the vehicle stands for good."""
    return _Loop(case, decider).run()


class _Loop:
    def __init__(self, case: Case, decider: str) -> None:
        self._case, self._preset = case, PRESETS[case.preset]
        self._scenario, self._vehicle = moving_world(case)
        configs: Configs = configs_of(case.preset)
        self._senses = Senses(self._scenario, configs, ego=case.ego and decider == "spotter")
        self._decider: Decider = DECIDERS[decider](configs)
        self._gate, self._fusion_host = GatePipeline(configs.gate), configs.gate.fusion_host
        self._drive = Drive(case, self._scenario)
        self._order = FREE
        self._verdict: Verdict | None = None
        self._decision: Decision | None = None
        self._stands_since_s: float | None = None
        self._look_again_s = 0.0
        self._queue: list[tuple[float, int, str, Any]] = []
        self._number = count()
        for name, period_s in self._senses.periods.items():
            self._push(period_s, "sensor", name)
        for name, period_s in (("verdict", configs.fusion.health.verdict_period_s), ("gate", configs.gate.period_s)):
            self._push(period_s, name, period_s)
        self._push(0.0, "watch", None)

    def _push(self, at_s: float, what: str, about: Any) -> None:
        heapq.heappush(self._queue, (at_s, next(self._number), what, about))

    def run(self) -> Drive:
        """All events in their order."""
        while not self._over():
            now_s, _, what, about = heapq.heappop(self._queue)
            self._vehicle.advance(now_s, self._in_force(now_s))
            getattr(self, f"_on_{what}")(now_s, about)
        return self._drive

    def _in_force(self, now_s: float) -> Order:
        """The last order that reached the brakes, once the gate has them."""
        return self._order if now_s >= BEGINS_S else FREE

    def _over(self) -> bool:
        """Hit; or the case's time is up and nothing is in the way any more, or the vehicle has stood before it."""
        now_s = self._vehicle.now_s
        if self._drive.impact_mps is not None or now_s >= self._case.ends_s + OVERTIME_S:
            return True
        if now_s < self._case.ends_s or now_s < self._look_again_s:
            return False
        self._look_again_s = now_s + LOOK_S
        rested = self._stands_since_s is not None and now_s - self._stands_since_s > RESTS_S
        return rested or contact_s(self._scenario.at(now_s), AHEAD_S) is None

    def _on_sensor(self, now_s: float, name: str) -> None:
        for arrival in self._senses.measure(name, now_s):
            self._push(arrival.at_s, "arrival", arrival)
        self._push(now_s + self._senses.periods[name], "sensor", name)

    def _on_arrival(self, now_s: float, arrival: Arrival) -> None:
        self._decider.take(arrival)
        self._decide(now_s)

    def _on_verdict(self, now_s: float, period_s: float) -> None:
        self._decide(now_s)
        self._push(now_s + period_s, "verdict", period_s)

    def _decide(self, now_s: float) -> None:
        self._verdict = self._decider.decide(now_s)
        self._push(now_s + VERDICT_TO_GATE_S, "verdict_at_gate", self._verdict)

    def _on_verdict_at_gate(self, now_s: float, verdict: Verdict) -> None:
        self._last_verdict, self._verdict_s = verdict, now_s
        self._ask_gate(now_s)

    def _on_gate(self, now_s: float, period_s: float) -> None:
        self._ask_gate(now_s)
        self._push(now_s + period_s, "gate", period_s)

    _last_verdict: Verdict | None = None
    _verdict_s = 0.0

    def _ask_gate(self, now_s: float) -> None:
        age_s = now_s - self._verdict_s + VERDICT_TO_GATE_S
        inputs = GateInputs(verdict=self._last_verdict, age_s=age_s, claimants=(f"{self._fusion_host}/fusion",))
        self._decision = self._gate.process(now_s, inputs)
        self._push(now_s + GATE_TO_ACTUATOR_S + self._preset.dead_time_s, "brakes", self._decision)

    def _on_brakes(self, now_s: float, decision: Decision) -> None:
        hard = decision.permission == "STOP"
        limit_mps = 0.0 if hard else decision.limit_mps
        self._order = Order(limit_mps, self._preset.brake_mps2 if hard else self._preset.slow_mps2)

    def _on_watch(self, now_s: float, _: Any) -> None:
        world = self._scenario.at(now_s)
        gap = gap_m(world)
        speed, x, y = self._vehicle.speed_mps, float(world.T_map_vehicle[0, 3]), float(world.T_map_vehicle[1, 3])
        yaw = math.atan2(world.T_map_vehicle[1, 0], world.T_map_vehicle[0, 0])
        self._stands_since_s = None if speed > 0.01 else self._stands_since_s or now_s
        planned, braking = self._vehicle.planned_mps, self._in_force(now_s).limit_mps < self._vehicle.planned_mps - 0.05
        self._drive.log.append(Moment(now_s, x, y, yaw, speed, planned, gap, self._verdict, self._decision, braking))
        if gap <= 0.0 and now_s > BEGINS_S:
            self._drive.impact_mps = closing_mps([(m.t_s, m.gap_m) for m in self._drive.log[-4:]])
        self._push(now_s + WATCH_S, "watch", None)


def closing_mps(gaps: list[tuple[float, float]]) -> float:
    """How fast the gap shrank before the contact, from (time, gap): the closing speed of the two, whichever moved."""
    (first_s, first_m), (last_s, last_m) = gaps[-4:][0], gaps[-1]
    return max(0.0, (first_m - last_m) / (last_s - first_s)) if last_s > first_s else 0.0
