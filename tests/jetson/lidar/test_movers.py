"""Who moves beside the way: bytes of the LD06 on a simulated vehicle that drives, through the service's pipeline."""

from __future__ import annotations

import numpy as np
import pytest

from common.bus.status import Report
from common.messages import LaserScan, Motion
from common.path import Path, PathConfig
from services.jetson.lidar.config import LidarConfig, MountingSection
from services.jetson.lidar.decoder import ScanDecoder
from services.jetson.lidar.filters import returns_of
from services.jetson.lidar.movers import Movers, Thing, reach_m
from services.jetson.lidar.pipeline import LidarPipeline
from spotter_sim import ld06
from spotter_sim.model import Scenario
from spotter_sim.odometry import measure
from spotter_tools.prove.dangers import cyclist_crossing, pedestrian_crossing
from spotter_tools.prove.innocents import gate, oncoming, overtaken, parked_rows, pillars, yard
from spotter_tools.prove.places import MEETS_S

CONFIG = LidarConfig(mounting=MountingSection(front_m=0.1))
START_NS = 1_800_000_000_000_000_000


def levels(scenario: Scenario, begin_s: float, end_s: float, *, known: bool = True) -> dict[float, str]:
    """The level of every scan, by the time at which it ended."""
    decoder, pipeline, said = ScanDecoder(CONFIG, Report("test")), LidarPipeline(CONFIG), {}
    for t in np.arange(begin_s, end_s, 8 / 300):
        odometry = measure(scenario.at(float(t)))
        motion = Motion(odometry.speed_mps, odometry.yaw_rate_radps) if known else None
        data = ld06.packets(scenario, float(t) - 8 / 300, float(t))
        for scan in decoder.feed(START_NS + round(t * 1e9), float(t), data):
            said[float(t)] = pipeline.process(scan.stamp_ns, scan, motion).level
    return said


@pytest.mark.parametrize(
    ("case", "before_s"),
    [
        (pedestrian_crossing(1.0, "near", 50), 1.0),
        (pedestrian_crossing(3.0, "near", 50), 1.1),
        (pedestrian_crossing(4.0, "near", 25), 1.1),
        (cyclist_crossing(2.0, "far"), 0.6),
    ],
    ids=lambda value: getattr(value, "name", value),
)
def test_who_will_be_in_the_way_alarms_while_still_beside_it(case, before_s):
    said = levels(case.scenario, MEETS_S - 3.0, MEETS_S - before_s + 0.15)
    assert "IMMINENT" in said.values()


def test_without_known_motion_only_what_is_in_a_lane_counts():
    said = levels(pedestrian_crossing(3.0, "near", 50).scenario, MEETS_S - 3.0, MEETS_S - 0.7, known=False)
    assert set(said.values()) == {"SAFE"}


@pytest.mark.parametrize(
    "case",
    [gate(1.0), parked_rows(2.0, 0.7), pillars(3.0), overtaken(3.0), oncoming(2.0, "cyclist")],
    ids=lambda case: case.name,
)
def test_who_passes_beside_and_what_stands_does_not(case):
    said = levels(case.scenario, MEETS_S - 4.0, MEETS_S + 0.5)
    assert len(said) > 30
    assert set(said.values()) == {"SAFE"}


@pytest.mark.parametrize(("number", "bend_ends_s"), [(0, 5.6), (1, 5.6), (2, 12.8)])
def test_where_a_bend_ends_what_stands_beside_the_way_does_not_move(number, bend_ends_s):
    said = levels(yard(3.0, number).scenario, bend_ends_s - 0.8, bend_ends_s + 0.8)
    assert len(said) > 12
    assert set(said.values()) == {"SAFE"}


@pytest.mark.parametrize(
    ("what", "walks_mps", "grows", "moves"),
    [("a body that walks", 1.4, False, True), ("a wall of which more comes into view", 0.0, True, False),
     ("a post", 0.0, False, False)],
)  # fmt: skip
def test_only_what_leaves_its_place_with_both_ends_moves(what, walks_mps, grows, moves):
    """Driving at 2 m/s past a wall: its near end stays over ground, its far end is where the view ends."""
    movers, motion = Movers(CONFIG), Motion(2.0)
    for k in range(9):
        near_m = 3.0 - 0.2 * k
        far_m = 3.6 if grows else near_m + 0.4
        y = -1.1 + walks_mps * 0.1 * k
        ends = np.array([[near_m, y], [far_m, y]])
        movers._predict(motion, motion, 0.1)
        movers._associate([Thing(ends.mean(axis=0), ends, far_m - near_m)])
    (mover,) = movers._movers
    assert mover.scans == 9
    assert movers._moves(mover, Path(CONFIG.path, motion)) == moves


def test_an_alarm_does_not_last_longer_when_the_clock_is_set_back():
    movers, nothing, motion = Movers(CONFIG), np.zeros(450), Motion(2.0)
    angles = np.linspace(-np.pi, np.pi, 450, endpoint=False)
    scan = LaserScan(stamp_ns=0, frame_id="lidar", angles_rad=angles, ranges_m=nothing, confidence=nothing)
    returns, used = returns_of(scan, CONFIG.mounting), nothing > 0
    movers.update(START_NS, returns, used, motion)
    movers._held = (START_NS + 400_000_000, "IMMINENT", 1.0)
    said = [movers.update(START_NS + k * 100_000_000, returns, used, motion)[0] for k in range(1, 4)]
    hour_ns = 3600 * 10**9
    said += [movers.update(START_NS - hour_ns + k * 100_000_000, returns, used, motion)[0] for k in range(8)]
    assert said == ["IMMINENT"] * 8 + ["SAFE"] * 3


def test_a_gap_in_the_scans_forgets_who_was_followed():
    case, movers = pedestrian_crossing(2.0, "near", 50), Movers(CONFIG)
    decoder, pipeline = ScanDecoder(CONFIG, Report("test")), LidarPipeline(CONFIG)
    pipeline._movers = movers
    t, scans = MEETS_S - 2.5, 0
    while t < MEETS_S - 1.6:
        t += 8 / 300
        for scan in decoder.feed(START_NS + round(t * 1e9), t, ld06.packets(case.scenario, t - 8 / 300, t)):
            pipeline.process(scan.stamp_ns, scan, Motion(2.0))
            scans += 1
    assert scans > 5
    assert max(mover.scans for mover in movers._movers) > 4
    scan.stamp_ns += 2_000_000_000
    pipeline.process(scan.stamp_ns, scan, Motion(2.0))
    assert max(mover.scans for mover in movers._movers) == 1


@pytest.mark.parametrize(
    ("speed_mps", "brake_mps2", "expected_m"),
    [
        (2.0, 3.0, 7.0),  # the setting is more than enough
        (3.5, 3.0, 7.0),  # 1.5 s and five turns of 0.1 s
        (5.5, 4.0, 11.0),
        (5.5, 1.0, 20.725),  # a stop takes longer than 1.5 s: 17.975 m, and five turns
    ],
)
def test_things_are_followed_from_so_far_that_imminent_comes_when_it_is_due(speed_mps, brake_mps2, expected_m):
    path = Path(PathConfig(brake_mps2=brake_mps2), Motion(speed_mps))
    assert reach_m(path, 0.1, CONFIG.movers) == pytest.approx(expected_m)
