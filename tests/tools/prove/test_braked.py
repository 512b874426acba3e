"""The vehicle of the proving ground: brakes along its plan."""

from __future__ import annotations

import numpy as np
import pytest

from spotter_sim.motion import Circuit, Straight, ellipse, line
from spotter_sim.tour import Stop, Tour
from spotter_tools.prove.braked import FREE, Braked, Order
from spotter_tools.prove.case import PRESETS

MODEL = PRESETS["model"]
STOP = Order(0.0, 3.0)


def test_without_an_order_it_does_what_the_plan_does():
    plan = Tour(line((0.0, 0.0), (12.0, 0.0)), 2.0, stops=(Stop(5.0, 1.0),))
    vehicle = Braked(plan, MODEL)
    vehicle.advance(plan.end_s, FREE)
    for t in np.linspace(0.0, plan.end_s, 50):
        assert vehicle.at(float(t)).x_m == pytest.approx(plan.at(float(t)).x_m, abs=0.03)


@pytest.mark.parametrize("speed_mps", [0.5, 2.0, 5.0])
def test_it_stops_within_the_braking_distance(speed_mps):
    vehicle = Braked(Straight((0.0, 0.0), 0.0, speed_mps), MODEL)
    vehicle.advance(1.0, FREE)
    at_m = vehicle.at(1.0).x_m
    vehicle.advance(6.0, STOP)
    assert vehicle.speed_mps == 0.0
    assert vehicle.at(6.0).x_m - at_m == pytest.approx(speed_mps**2 / 6.0, abs=0.02 * speed_mps)
    assert vehicle.at(6.0).vx_mps == 0.0


def test_it_brakes_along_its_way_and_goes_on_with_bounded_acceleration():
    plan = Circuit(ellipse((0.0, 0.0), (2.0, 2.0)), 6.0)
    vehicle = Braked(plan, MODEL)
    vehicle.advance(1.0, FREE)
    vehicle.advance(3.0, Order(0.5, 2.0))
    assert vehicle.speed_mps == pytest.approx(0.5)
    vehicle.advance(4.0, STOP)
    vehicle.advance(7.0, FREE)
    times = np.arange(0.0, 7.0, 0.02)
    poses = [vehicle.at(float(t)) for t in times]
    assert np.allclose([np.hypot(p.x_m, p.y_m) for p in poses], 2.0, atol=1e-3)
    speed = np.array([np.hypot(p.vx_mps, p.vy_mps) for p in poses])
    assert np.diff(speed).max() < 1.6 * 0.02
    assert np.diff(speed).min() > -3.1 * 0.02
    way = np.cumsum(0.5 * (speed[1:] + speed[:-1]) * 0.02)  # speeds and places tell the same
    turned = np.unwrap([np.arctan2(p.y_m, p.x_m) for p in poses])
    assert 2.0 * (turned[-1] - turned[0]) == pytest.approx(way[-1], abs=0.05)
    assert speed[-1] == pytest.approx(plan.path.length_m / 6.0, abs=0.01)


def test_what_was_is_not_changed_by_what_comes():
    vehicle = Braked(Straight((0.0, 0.0), 0.0, 2.0), MODEL)
    vehicle.advance(1.0, FREE)
    before = [vehicle.at(t) for t in (0.1, 0.55, 0.995)]
    vehicle.advance(2.0, STOP)
    assert [vehicle.at(t) for t in (0.1, 0.55, 0.995)] == before
