"""The demonstration's story against the simulated truth: world -> wire data -> all pipelines -> verdict and health.

Every service's own source, parser and pipeline run on a simulated clock, one after the other; what they would publish
is delivered to fusion in the order of time. No process, no network, no waiting: the same figures on every machine.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache

import numpy as np
import pytest

from common.bus.pubsub import Received
from common.messages import LEVELS, SensorHealth, Verdict
from services.jetson.fusion.config import FusionConfig, RoadsideConfig
from services.jetson.fusion.observation import Observation
from services.jetson.fusion.pipeline import FusionPipeline
from spotter_sim.truth import expect
from spotter_sim.world import SCENARIOS
from tests.system.simulated_services import KEYS, SERVICES, START_NS, run_service

pytestmark = pytest.mark.slow

LAG_S = 1.4  # the verdict's delay: persistence, and eight messages of a sensor without what it has alarmed of
LEAD_S = 0.3  # the roadside sees an approach before the vehicle does
FAULT_LAG_S = 2.5  # until a fault is noticed (lidar: 15 scans) and an alarm it may hide has been let go
STEP_S = 0.1  # between two looks at the truth
SETTLED_S = 2.0  # after the start: the radar has learned its background


@dataclass
class Story:
    """What fusion said: verdicts, and health whenever it was told."""

    scenario: str
    verdicts: list[tuple[float, Verdict]] = field(default_factory=list)
    health: list[tuple[float, dict[str, SensorHealth]]] = field(default_factory=list)

    def levels(self) -> list[str]:
        """Levels in the order in which they came, after settling, without repetitions."""
        levels = [verdict.level for at_s, verdict in self.verdicts if at_s >= SETTLED_S]
        return [level for i, level in enumerate(levels) if i == 0 or level != levels[i - 1]]

    def states(self, sensor: str, begin_s: float, end_s: float) -> set[str]:
        return {h[sensor].state for at_s, h in self.health if begin_s <= at_s < end_s}

    def reasons(self, sensor: str, begin_s: float, end_s: float) -> set[str]:
        return {h[sensor].reason for at_s, h in self.health if begin_s <= at_s < end_s}


def tell(scenario: str, seconds: float, names: Iterable[str]) -> Story:
    """Run the services one by one, then fusion on all they sent, in the order of arrival."""
    names = list(names)
    log = sorted((one for name in names for one in run_service(name, scenario, seconds)), key=lambda one: one[0])
    present = frozenset((KEYS[name].split("/")[0], name, "a") for name in names)
    pipeline = FusionPipeline(FusionConfig(roadside=RoadsideConfig(enabled="infra_lidar" in names)))
    story = Story(scenario)
    for at_s, key, message in log:
        now_ns = START_NS + round(at_s * 1e9)
        received = (Received(key, message, at_s, now_ns),)
        verdict, health = pipeline.process(Observation(now_s=at_s, now_ns=now_ns, received=received, present=present))
        story.verdicts.append((at_s, verdict))
        if health is not None:
            story.health.append((at_s, dict(health.sensors)))
    assert not pipeline.bad_input
    return story


@pytest.fixture(scope="module")
def crossing() -> Story:
    """Two turns; in the second one the pole's lidar has learned its background."""
    return tell("crossing", 2 * SCENARIOS["crossing"].length_s, SERVICES)


@pytest.fixture(scope="module")
def faults() -> Story:
    return tell("faults", SCENARIOS["faults"].length_s, [name for name in SERVICES if name != "infra_lidar"])


@cache
def true_ranks(scenario: str) -> np.ndarray:
    """The rank of the true verdict every 0.1 s; one second beyond the scenario's end."""
    times = np.arange(0.0, max(30.0, SCENARIOS[scenario].length_s), STEP_S)
    ranks = [LEVELS.index(expect(scenario, float(t)).verdict) for t in times]
    return np.array(ranks + ranks[:10])


def around(scenario: str, at_s: float, lag_s: float) -> np.ndarray:
    """The true ranks in the last ``lag_s`` and the next ``LEAD_S``."""
    first, last = math.floor((at_s - lag_s) / STEP_S), math.ceil((at_s + LEAD_S) / STEP_S)
    return true_ranks(scenario)[max(0, first) : last + 1]


def test_crossing_goes_up_and_down_twice_a_turn(crossing: Story) -> None:
    """CAUTION, then IMMINENT, for the person and for the car; an alarm is held until nobody sees it, then SAFE."""
    levels = [level for level in crossing.levels() if level != "CAUTION"]
    assert levels[:8] == [*4 * ["SAFE", "IMMINENT"]]  # the last alarm may be held to the story's end
    sequence = crossing.levels()
    assert all(before == "CAUTION" for before, level in itertools.pairwise(sequence) if level == "IMMINENT")


def test_crossing_follows_the_truth(crossing: Story) -> None:
    """Every verdict is a level that was true in the last 1.4 s or will be in the next 0.3 s, or between two such."""
    for at_s, verdict in crossing.verdicts:
        if at_s >= SETTLED_S:
            near = around("crossing", at_s, LAG_S)
            assert near.min() <= LEVELS.index(verdict.level) <= near.max(), f"{at_s:.2f} s: {verdict.because}"


def test_the_roadside_raises_an_alarm_that_the_page_shows(crossing: Story) -> None:
    """Both who come up to the vehicle are seen by the pole as well, the car before any sensor on board tells of it."""
    raised = {
        (verdict.inputs["infra_lidar"].level, verdict.inputs["infra_lidar"].used) for _, verdict in crossing.verdicts
    }
    assert {("CAUTION", True), ("IMMINENT", True)} <= raised
    assert "I1-roadside" in {verdict.rule for _, verdict in crossing.verdicts}


@pytest.mark.parametrize("story", ["crossing", "faults"])
def test_never_safe_while_it_is_imminent(story: str, request: pytest.FixtureRequest) -> None:
    recorded: Story = request.getfixturevalue(story)
    imminent = true_ranks(story) == LEVELS.index("IMMINENT")
    for at_s, verdict in recorded.verdicts:
        before = int(at_s / STEP_S)
        if at_s >= SETTLED_S and verdict.level == "SAFE":
            assert not imminent[before : before + 2].all(), f"{at_s:.2f} s: {verdict.because}"


def test_every_sensor_is_online_while_nothing_is_wrong(crossing: Story) -> None:
    for sensor in ("radar", "lidar", "camera", "infra_lidar"):
        assert crossing.states(sensor, SETTLED_S, 99.0) == {"online"}, crossing.reasons(sensor, SETTLED_S, 99.0)


@pytest.mark.parametrize(
    ("sensor", "begin_s", "end_s", "within_s", "state", "reason"),
    [
        ("lidar", 4.0, 9.0, 2.0, "degraded", "no return up to 12 m"),
        ("lidar", 13.0, 18.0, 0.7, "disconnected", "connected but silent"),
        ("camera", 22.0, 27.0, 0.4, "degraded", "dark"),
        ("camera", 31.0, 36.0, 0.4, "disconnected", "unplugged"),
        ("radar", 40.0, 45.0, 0.3, "disconnected", "sends no frame"),
        ("radar", 49.0, 54.0, 0.3, "disconnected", "unplugged"),
        ("lidar", 58.0, 63.0, 2.0, "degraded", "no return up to 12 m"),
        ("camera", 58.0, 63.0, 0.4, "degraded", "dark"),
        ("radar", 67.0, 72.0, 0.3, "disconnected", "sends no frame"),
    ],
)
def test_a_fault_is_told(
    faults: Story, sensor: str, begin_s: float, end_s: float, within_s: float, state: str, reason: str
) -> None:
    """Online before, then the state and the reason in time, until the fault ends; well again within 2.5 s."""
    assert faults.states(sensor, begin_s - 1.0, begin_s) == {"online"}
    assert faults.states(sensor, begin_s + within_s, end_s) == {state}
    assert all(reason in why for why in faults.reasons(sensor, begin_s + within_s, end_s - 0.1))
    assert faults.states(sensor, end_s + FAULT_LAG_S, end_s + FAULT_LAG_S + 0.5) == {"online"}


def test_faults_touch_nobody_else(faults: Story) -> None:
    """While one sensor is out the others stay online."""
    for at_s, health in faults.health:
        wrong = {name for name in ("radar", "lidar", "camera") if health[name].state != "online"}
        if SETTLED_S <= at_s < 58.0:
            assert len(wrong) <= 1, f"{at_s:.2f} s: {wrong}"


def test_faults_follow_the_truth(faults: Story) -> None:
    """As in ``crossing``, with more time after a fault has begun or ended; the alarm of a lost sensor is held."""
    edges = np.array([edge for fault in SCENARIOS["faults"].faults for edge in (fault.start_s, fault.end_s)])
    for at_s, verdict in faults.verdicts:
        since_s = at_s - edges
        fresh = ((since_s >= 0.0) & (since_s < FAULT_LAG_S)).any()
        if at_s >= SETTLED_S:
            near, rank = around("faults", at_s, FAULT_LAG_S if fresh else LAG_S), LEVELS.index(verdict.level)
            assert near.min() <= rank, f"{at_s:.2f} s: {verdict.because}"
            assert rank <= near.max() or verdict.rule == "H1-held", f"{at_s:.2f} s: {verdict.because}"


def test_blind_is_never_safe(faults: Story) -> None:
    """All three out: CAUTION or worse, and the vehicle stops."""
    blind = [verdict for at_s, verdict in faults.verdicts if 69.0 <= at_s < 72.0]
    assert blind
    assert all(v.blind and v.level != "SAFE" and v.permission == "STOP" for v in blind)
