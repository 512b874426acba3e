"""Motions are smooth: positions, velocities and headings agree, accelerations are those of people and cars."""

from __future__ import annotations

import numpy as np
import pytest

from spotter_sim.motion import Circuit, Errand, Ride, bezier, ellipse, line
from spotter_sim.world import SCENARIOS

STEP_S = 0.02


@pytest.mark.parametrize(
    ("length_m", "speed_mps"),
    [
        (10.0, 2.0),  # long enough to cruise
        (4.0, 1.0),
        (3.0, 2.0),  # barely reaches its speed
    ],
)
def test_ride_goes_from_rest_to_rest_over_its_whole_path(length_m, speed_mps):
    ride = Ride(line((0.0, 0.0), (length_m, 0.0)), 0.0, speed_mps, 1.5)
    times = np.linspace(0, ride.duration_s, 200)
    way = np.array([ride.pose(t).x_m for t in times])
    speed = np.array([ride.pose(t).vx_mps for t in times])
    assert way[0] == 0.0
    assert way[-1] == pytest.approx(length_m)
    assert speed[0] == pytest.approx(0.0, abs=1e-9)
    assert speed[-1] == pytest.approx(0.0, abs=1e-6)
    assert speed.max() == pytest.approx(speed_mps, rel=0.02)
    assert np.all(np.diff(way) >= 0)


def test_backwards_ride_heads_against_its_motion():
    pose = Ride(line((0.0, 0.0), (5.0, 0.0)), 0.0, 1.0, backwards=True).pose(2.0)
    assert pose.vx_mps == pytest.approx(1.0)
    assert np.cos(pose.yaw_rad) == pytest.approx(-1.0)


def test_errand_waits_and_turns_between_rides():
    there = Ride(line((0.0, 0.0), (3.0, 0.0)), 1.0, 1.0)
    back = Ride(line((3.0, 0.0), (0.0, 0.0)), 7.0, 1.0)
    errand = Errand((there, back), 14.0)
    waiting = errand.at(6.0)
    assert (waiting.x_m, waiting.vx_mps) == (pytest.approx(3.0), 0.0)
    assert 0.1 < abs(waiting.yaw_rad) < 3.1  # on the way round
    assert errand.at(0.5).x_m == pytest.approx(0.0)  # before the first ride: where the last one ended
    assert errand.at(14.5).x_m == pytest.approx(errand.at(0.5).x_m)


def test_circuit_returns_after_its_laps():
    circuit = Circuit(ellipse((2.0, 1.0), (3.0, 1.0), -1.0), 15.0, laps=2, phase=0.25)
    a, b = circuit.at(3.0), circuit.at(10.5)
    assert (a.x_m, a.y_m) == (pytest.approx(b.x_m), pytest.approx(b.y_m))


def test_bezier_heading_follows_its_ends():
    path = bezier((0.0, 0.0), (1.0, 0.0), (2.0, 1.0), (2.0, 2.0))
    assert path.point(0.0)[2] == pytest.approx(0.0, abs=0.02)
    assert path.point(path.length_m)[2] == pytest.approx(np.pi / 2, abs=0.02)


def _players():
    return [pytest.param(p, id=f"{p.kind}-{p.actor_id}") for p in SCENARIOS["crossing"].cast]


@pytest.mark.parametrize("player", _players())
def test_everybody_in_the_crossing_moves_smoothly(player):
    times = np.arange(0.0, 15.0, STEP_S)
    poses = [player.motion.at(t) for t in times]
    place = np.array([(p.x_m, p.y_m) for p in poses])
    speed = np.array([(p.vx_mps, p.vy_mps) for p in poses])
    measured = np.gradient(place, STEP_S, axis=0)
    assert np.abs(measured - speed)[1:-1].max() < 0.06
    assert np.linalg.norm(np.diff(speed, axis=0) / STEP_S, axis=1).max() < 4.5
    if player.kind == "pedestrian":
        assert np.linalg.norm(speed, axis=1).max() < 2.0


def test_walker_approaches_at_a_walking_pace():
    person = SCENARIOS["crossing"].cast[0]
    speeds = [np.hypot(p.vx_mps, p.vy_mps) for p in (person.motion.at(t) for t in np.arange(0, 15, 0.1))]
    assert 1.2 <= max(speeds) <= 1.4


@pytest.mark.parametrize("player", _players()[:2])
def test_the_loop_closes_for_those_who_approach(player):
    before, after = player.motion.at(15.0 - 1e-6), player.motion.at(0.0)
    assert (before.x_m, before.y_m) == (pytest.approx(after.x_m, abs=1e-4), pytest.approx(after.y_m, abs=1e-4))


def test_the_street_looks_the_same_at_both_ends_of_the_loop():
    """Passing traffic hands its place on to the next of its kind; only beyond 90 m somebody appears or vanishes."""
    crossing = SCENARIOS["crossing"]
    ends = [crossing.at(t).actors for t in (15.0 - 1e-9, 0.0)]
    for one, other in (ends, ends[::-1]):
        for actor in one:
            if abs(actor.position_m[1]) < 90.0:
                gaps = [np.linalg.norm(a.position_m - actor.position_m) for a in other if a.kind == actor.kind]
                assert min(gaps) < 0.01, (actor.kind, actor.position_m)
