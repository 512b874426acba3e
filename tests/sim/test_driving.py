"""The vehicle drives: what every sensor sees of it, against plain references that ask the world at each own moment."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from common.geometry import invert
from spotter_sim import bgt60, camera, ld06, odometry
from spotter_sim.contact import contact_s, gap_m
from spotter_sim.emergency import STOPS_M
from spotter_sim.model import Player, Scenario
from spotter_sim.motion import Circuit, Standing, Straight, ellipse, line
from spotter_sim.scene import Ground, Mount, Scene, post, wall
from spotter_sim.solids import join
from spotter_sim.tour import Stop, Tour, rounded
from spotter_sim.truth import expect, radar_targets
from spotter_sim.vehicle import CART, MODEL_CAR
from spotter_sim.world import SCENARIOS, world_at
from spotter_sim.yard import YARDS, drive, plan_of


def street(vehicle, cast=(), chassis=MODEL_CAR):
    """A street along x: a wall at each side, a post, a wall across its end."""
    fixtures = [wall((-5.0, 40.0), (2.0, 2.2), 1.5), wall((-5.0, 40.0), (-2.4, -2.2), 1.5), post(9.0, 0.8, 0.0, 1.5)]
    scene = Scene(Ground(), join([*fixtures, wall((14.0, 14.2), (-2.0, 2.0), 1.5)]), Mount(0.0, -9.0))
    return Scenario("street", 20.0, scene, tuple(cast), vehicle=vehicle, chassis=chassis)


STRAIGHT = Straight((0.0, 0.0), 0.1, 2.5, 20.0)
ROUND = Circuit(ellipse((3.0, 0.0), (1.5, 1.5)), 20.0, laps=5)


@pytest.mark.parametrize("motion", [STRAIGHT, ROUND])
@pytest.mark.parametrize("chassis", [MODEL_CAR, CART])
def test_pose_velocity_and_turn_follow_the_motion(motion, chassis):
    scenario, step = street(motion, chassis=chassis), 1e-3
    before, now, after = (world_at(scenario, t) for t in (1.3 - step, 1.3, 1.3 + step))
    change = invert(before.T_map_vehicle) @ after.T_map_vehicle
    assert now.vehicle_speed_mps == pytest.approx(np.linalg.norm(change[:3, 3]) / (2 * step), rel=2e-3)
    assert now.vehicle_yaw_rate_radps == pytest.approx(np.arctan2(change[1, 0], change[0, 0]) / (2 * step), abs=0.02)
    place = [(w.T_map_vehicle @ chassis.T_vehicle_radar)[:3, 3] for w in (before, after)]
    np.testing.assert_allclose(
        now.vehicle.velocity_of(chassis.T_vehicle_radar), (place[1] - place[0]) / (2 * step), atol=0.02
    )
    predicted = now.vehicle.T_map_vehicle_after(np.array([step, 0.1]))
    np.testing.assert_allclose(predicted[0], after.T_map_vehicle, atol=1e-4)
    np.testing.assert_allclose(predicted[1], world_at(scenario, 1.4).T_map_vehicle, atol=0.02)


@pytest.mark.parametrize("motion", [STRAIGHT, ROUND])
def test_every_echo_comes_nearer_as_its_distance_shrinks(motion):
    """Doppler of what stands: range rate by finite differences, of every fixture and patch."""
    scenario, step = street(motion), 1e-3
    worlds = [world_at(scenario, t) for t in (2.0 - step, 2.0, 2.0 + step)]
    fixtures = bgt60.patches(scenario.scene.fixtures)
    assert len(fixtures) > 80  # the long walls in pieces
    rows = bgt60.driving_echoes(worlds[1], fixtures)
    ranges = [
        np.linalg.norm(bgt60.facing_point(fixtures, (w.T_map_vehicle @ MODEL_CAR.T_vehicle_radar)[:3, 3])
                       - (w.T_map_vehicle @ MODEL_CAR.T_vehicle_radar)[:3, 3], axis=1)
        for w in (worlds[0], worlds[2])
    ]  # fmt: skip
    far = rows[:, 0] > 0.3
    np.testing.assert_allclose(rows[far, 1], ((ranges[1] - ranges[0]) / (2 * step))[far], atol=0.02)
    assert rows[far, 1].min() < -1.0


def test_a_frame_shows_the_wall_ahead_at_the_own_speed():
    """The strongest Doppler bin of the wall's range, from the raw chirps."""
    scenario, waveform = street(Straight((9.0, 0.0), 0.0, 2.0, 20.0)), bgt60.Waveform()
    frame = bgt60.frame(scenario, 0.5)[0].astype(float)  # 3.8 m before the wall, less the radar's place
    moving = (frame - frame.mean(axis=0)) * np.hanning(frame.shape[1])  # without the leakage, which stands still
    spectrum = np.fft.fft(moving, axis=1)[:, 4:50]  # (chirp, range)
    doppler = np.abs(np.fft.fftshift(np.fft.fft(spectrum * np.hanning(64)[:, None], axis=0), axes=0))
    row, column = np.unravel_index(doppler.argmax(), doppler.shape)
    velocity_mps = (row - 32) * waveform.wavelength_m / (2 * 64 * waveform.chirp_period_s)
    range_m = (column + 4) * bgt60.C_MPS / (2 * waveform.sampled_bandwidth_hz)
    assert velocity_mps == pytest.approx(-2.0, abs=0.12)
    assert range_m == pytest.approx(3.8, abs=0.15)


@pytest.mark.parametrize("motion", [STRAIGHT, ROUND])
def test_each_ray_of_the_ld06_leaves_at_its_own_time(motion):
    """A block of rays against the plain way: the world of each ray's own moment, one ray at a time."""
    scenario = street(motion, [Player(1, "car", Straight((12.0, 0.5), np.pi, 1.5, 20.0))])
    middle_s, n = 1.0, 120
    angles = -np.radians(np.arange(n) * 0.8 - 48.0)
    got, _ = ld06.skewed_ranges(world_at(scenario, middle_s), angles)
    seconds = (np.arange(n) - 0.5 * n) / ld06.SAMPLE_HZ
    plain = [
        ld06.slice_ranges(world_at(scenario, middle_s + dt), np.array([a]))[0][0]
        for dt, a in zip(seconds, angles, strict=True)
    ]
    both = np.isfinite(got) & np.isfinite(plain)
    assert both.sum() > 0.95 * np.isfinite(plain).sum() > 60
    error = np.abs(got[both] - np.array(plain)[both])
    assert np.quantile(error, 0.97) < 0.01  # the rest are rays at an edge
    frozen, _ = ld06.slice_ranges(world_at(scenario, middle_s), angles)
    assert np.median(np.abs(frozen[both] - np.array(plain)[both])) > 2 * np.median(
        error
    )  # without skew it is not the same


def test_a_standing_vehicle_with_a_motion_sees_the_same_as_one_without():
    cast = [Player(1, "pedestrian", Straight((4.0, 0.2), np.pi, 1.2, 20.0))]
    moved, plain = (world_at(street(motion, cast), 0.7) for motion in (Standing(0.0, 0.0), None))
    assert (moved.drives, plain.drives) == (True, False)
    angles = np.radians(np.linspace(60.0, -60.0, 120))
    a, b = ld06.skewed_ranges(moved, angles)[0], ld06.slice_ranges(plain, angles)[0]
    np.testing.assert_allclose(a, b, atol=0.03)
    assert radar_targets(moved) == radar_targets(plain)
    assert odometry.measure(moved)[:2] == (0.0, 0.0)


def test_true_radar_velocity_is_relative_to_the_vehicle():
    ahead = Player(1, "car", Straight((6.0, 0.0), 0.0, 1.0, 20.0))
    (target,) = radar_targets(world_at(street(Straight((0.0, 0.0), 0.0, 2.5, 20.0), [ahead]), 1.0))
    assert target.velocity_mps == pytest.approx(-1.5, abs=0.05)


def test_odometry_is_near_the_truth_and_repeats():
    world = world_at(street(ROUND), 3.0)
    measured = odometry.measure(world)
    assert measured.speed_mps == pytest.approx(world.vehicle_speed_mps, rel=0.03)
    assert measured.yaw_rate_radps == pytest.approx(world.vehicle_yaw_rate_radps, abs=0.05)
    assert odometry.measure(world)[:2] == measured[:2]


def test_odometry_states_how_well_it_measures():
    worlds = [world_at(street(ROUND), 1.0 + 0.13 * i) for i in range(60)]
    measured = [odometry.measure(world) for world in worlds]
    speed = [(m.speed_mps - w.vehicle_speed_mps) / m.speed_sigma_mps for m, w in zip(measured, worlds, strict=True)]
    turn = [
        (m.yaw_rate_radps - w.vehicle_yaw_rate_radps) / m.yaw_rate_sigma_radps
        for m, w in zip(measured, worlds, strict=True)
    ]
    for errors in (speed, turn):
        assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.5
    stands = odometry.measure(world_at(street(Standing(0.0, 0.0)), 1.0))
    assert (stands.speed_mps, stands.speed_sigma_mps) == (0.0, odometry.STANDS_MPS)


def test_the_camera_drives_along():
    scenario = street(Straight((0.0, 0.0), 0.0, 1.5, 20.0), [Player(1, "car", Standing(12.0, 0.0))])
    (far,), (near,) = camera.boxes(scenario, 0.0), camera.boxes(scenario, 2.0)
    assert far.distance_m - near.distance_m == pytest.approx(3.0, abs=1e-6)
    assert np.mean(np.abs(camera.image(scenario, 0.0).astype(int) - camera.image(scenario, 2.0))) > 5


@pytest.mark.parametrize("yard", range(YARDS))
@pytest.mark.parametrize("speed_mps", [1.0, 3.0])
def test_a_lap_of_the_yard_is_smooth_and_ends_where_it_began(yard, speed_mps):
    scenario = drive(speed_mps, yard)
    times = np.arange(0.0, scenario.length_s, 0.02)
    states = [world_at(scenario, float(t)).vehicle for t in times]
    speed = np.array([state.speed_mps for state in states])
    turn = np.array([state.yaw_rate_radps for state in states])
    assert speed.max() == pytest.approx(speed_mps, rel=0.01)
    assert np.abs(np.diff(speed)).max() < 2.2 * 0.02
    assert np.abs(np.diff(turn)).max() < 0.35  # the wheels turn, they do not jump
    assert np.abs(speed * turn).max() < 3.3
    np.testing.assert_allclose(states[0].T_map_vehicle, states[-1].T_map_vehicle, atol=1e-6)
    heights = [state.T_map_vehicle[2, 3] for state in states]
    assert max(heights) == pytest.approx(plan_of(yard).rise_m, abs=1e-6)  # it has been on the ramp
    assert not np.any(scenario.at(2.0).faults)


def test_no_such_yard():
    with pytest.raises(ValueError, match="no yard 3"):
        drive(2.0, YARDS)


def test_a_tour_stops_where_it_is_told():
    tour = Tour(line((0.0, 0.0), (10.0, 0.0)), 2.0, stops=(Stop(4.0, 1.5),), first_mps=2.0)
    assert tour.at(0.0).vx_mps == 2.0
    times = np.arange(0.0, tour.end_s, 0.01)
    standing = [t for t in times if abs(tour.at(float(t)).x_m - 4.0) < 0.02 and tour.at(float(t)).vx_mps < 1e-6]
    assert standing[-1] - standing[0] == pytest.approx(1.5, abs=0.1)
    assert tour.at(99.0).x_m == pytest.approx(10.0)


def test_rounded_corners_keep_to_the_lines_between_the_bends():
    path = rounded([(0.0, 0.0), (10.0, 0.0), (10.0, 8.0)], 2.0)
    places = np.array([path.point(s) for s in np.linspace(0.0, path.length_m, 200)])
    assert np.all(np.abs(places[places[:, 0] < 8.0, 1]) < 1e-9)
    assert np.all(np.abs(places[places[:, 1] > 2.0, 0] - 10.0) < 1e-9)


def test_a_lidar_on_the_ramp_sees_the_ground():
    """Nose down on the way down, the plane of the lidar meets the level ground ahead."""
    scenario = drive(2.0)
    lap = [world_at(scenario, float(t)) for t in np.arange(0.0, scenario.length_s, 0.05)]
    steepest = min(lap, key=lambda world: world.T_map_vehicle[2, 0])
    open_sky = replace(steepest, scene=replace(steepest.scene, fixtures=post(90.0, 0.0, 0.0, 1.0)))
    with_ground, _ = ld06.skewed_ranges(steepest, np.zeros(12))
    assert np.isfinite(with_ground).all()
    assert with_ground.min() > 2.0
    assert np.isinf(ld06.skewed_ranges(open_sky, np.zeros(12))[0]).all()


def test_nothing_in_the_yard_is_ever_in_the_way():
    for yard in range(YARDS):
        scenario = drive(2.0, yard)
        gaps = [gap_m(world_at(scenario, float(t))) for t in np.arange(0.0, scenario.length_s, 0.1)]
        assert min(gaps) == pytest.approx(plan_of(yard).gate_room_m, abs=0.02)


def test_five_dangers_on_the_lap_and_none_is_hit():
    scenario = SCENARIOS["emergency"]
    times = np.arange(0.0, scenario.length_s, 0.2)
    assert min(gap_m(world_at(scenario, float(t))) for t in times) > 0.3
    tour = scenario.vehicle
    assert isinstance(tour, Tour)
    for at_m in STOPS_M.values():
        late = times[(times > tour.when(at_m) - 2.0) & (times < tour.when(at_m) + 0.3)]
        near = [contact_s(world_at(scenario, float(t)), 4.0) for t in late]
        assert min((seconds for seconds in near if seconds is not None), default=9.0) < 2.5
    alarmed = tour.when(STOPS_M["child"]) - 0.6
    assert expect(scenario, alarmed).contact_s == contact_s(world_at(scenario, alarmed), 4.0)
    assert expect("crossing", 3.0).contact_s is None
