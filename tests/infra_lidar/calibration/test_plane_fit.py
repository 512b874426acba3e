"""Where the road is: exact on planes, robust on streets, refused where it cannot be known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.geometry import rotation_rpy, transform_points
from services.infra_lidar.calibration.monitor import CHECKS_TO_BELIEVE, CalibrationMonitor
from services.infra_lidar.calibration.plane_fit import Calibrator
from services.infra_lidar.config import CalibrationConfig

CONFIG = CalibrationConfig(hypotheses=300)
KINDS = ("open", "level", "facade", "trees", "slope", "bus", "crowd")


def _angle_deg(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


@settings(max_examples=15, deadline=None)
@given(
    roll=st.floats(-0.15, 0.15), pitch=st.floats(-0.4, 0.4), height=st.floats(0.0, 9.0), seed=st.integers(0, 1000)
)  # fmt: skip
def test_a_plane_is_found_at_any_mounting(plane_cloud, roll, pitch, height, seed):
    cloud = plane_cloud(height, roll, pitch, seed=seed, points=6000)
    found = Calibrator(CONFIG).add(cloud)
    assert not found.refused
    true_normal = np.array([0.0, 0.0, 1.0]) @ rotation_rpy(roll, pitch, 0.0)
    assert _angle_deg(found.normal, true_normal) < 0.05
    assert abs(found.height_m - height) < 0.01
    near = cloud[np.linalg.norm(cloud, axis=1) < 10]
    assert np.abs(np.median(transform_points(found.T_level_sensor, near)[:, 2])) < 0.01


@pytest.mark.parametrize("kind", KINDS)
def test_streets_are_levelled_by_the_road_at_the_foot(scene_frame, kind):
    errors = []
    for seed in (0, 1, 2):
        frame = scene_frame(kind, seed)
        found = Calibrator(CalibrationConfig()).add(frame.points)
        assert not found.refused
        errors.append(_angle_deg(found.normal, frame.T_level_sensor[2, :3]))
        assert abs(found.height_m - frame.T_level_sensor[2, 3]) < 0.05
    assert np.median(errors) < 0.15
    assert max(errors) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_twenty_streets_of_each_kind(scene_frame, kind):
    errors = []
    for seed in range(20):
        frame = scene_frame(kind, seed, columns=900)
        found = Calibrator(CalibrationConfig()).add(frame.points)
        if not found.refused:
            errors.append(_angle_deg(found.normal, frame.T_level_sensor[2, :3]))
    assert len(errors) >= 18
    assert np.median(errors) < 0.1
    assert max(errors) < 0.5


def test_the_same_cloud_gives_the_same_answer(plane_cloud):
    cloud = plane_cloud()
    first, second = (Calibrator(CONFIG).add(cloud) for _ in range(2))
    assert np.array_equal(first.T_level_sensor, second.T_level_sensor)


def test_a_wall_alone_is_refused():
    rng = np.random.default_rng(3)
    wall = np.column_stack([rng.normal(5.0, 0.01, 5000), rng.uniform(-8, 8, 5000), rng.uniform(-4, 4, 5000)])
    found = Calibrator(CONFIG).add(wall.astype(np.float32))
    assert found.refused


@pytest.mark.parametrize("cloud", [np.zeros((0, 3)), np.zeros((500, 3)), np.full((500, 3), np.nan)])
def test_an_empty_view_is_refused_with_a_reason(cloud):
    found = Calibrator(CONFIG).add(cloud.astype(np.float32))
    assert "points" in found.refused


def test_too_little_road_is_refused(plane_cloud):
    cloud = plane_cloud(points=40_000)
    found = Calibrator(CONFIG).add(cloud[np.hypot(cloud[:, 0] - 5, cloud[:, 1]) < 2.5])
    assert "square metres" in found.refused


def test_a_bus_roof_is_not_the_road(plane_cloud):
    cloud = plane_cloud(5.0, pitch_rad=0.0, boxes=((6.0, 0.0, 12.0, 2.5, 3.2),), points=4000)
    rng = np.random.default_rng(1)
    roof = np.column_stack([rng.uniform(0, 12, 6000), rng.uniform(-1.25, 1.25, 6000), rng.normal(-1.8, 0.01, 6000)])
    found = Calibrator(CONFIG).add(np.vstack([cloud, roof.astype(np.float32)]))
    assert abs(found.height_m - 5.0) < 0.03


def _watch(monitor, cloud, stamp_s):
    calibration = monitor.update(cloud)
    monitor.monitor(int(stamp_s * 1e9), transform_points(calibration.T_level_sensor, cloud[:, :3]))


def test_the_calibration_settles_and_a_standing_pole_is_left_alone(plane_cloud):
    monitor = CalibrationMonitor(CONFIG)
    for k in range(15):
        _watch(monitor, plane_cloud(seed=k, points=8000), 1.0 + 2.5 * k)
    assert monitor.settled
    assert monitor.fault == ""
    assert monitor.nudge_deg < 0.1
    assert abs(monitor.nudge_m) < 0.02


@pytest.mark.parametrize(("pitch_rad", "height_m"), [(0.2 + np.radians(1.0), 5.0), (0.2, 5.15)])
def test_a_nudge_is_noticed_and_measured(plane_cloud, pitch_rad, height_m):
    monitor = CalibrationMonitor(CONFIG)
    for k in range(6):
        _watch(monitor, plane_cloud(seed=k, points=8000), 1.0 + 2.5 * k)
    for k in range(6, 6 + CHECKS_TO_BELIEVE):
        _watch(monitor, plane_cloud(height_m, 0.0, pitch_rad, seed=k, points=8000), 1.0 + 2.5 * k)
    assert "has moved" in monitor.fault
    assert monitor.nudge_deg == pytest.approx(np.degrees(pitch_rad - 0.2), abs=0.1)
    assert monitor.nudge_m == pytest.approx(5.0 - height_m, abs=0.03)
    monitor.restart()
    assert monitor.fault == ""


def test_a_recalibration_that_is_refused_is_not_silent(plane_cloud):
    config = CalibrationConfig(hypotheses=300, max_tilt_deg=15.0)
    monitor = CalibrationMonitor(config)
    for k in range(6):
        _watch(monitor, plane_cloud(seed=k, points=8000), 1.0 + 2.5 * k)
    before = monitor.settled_calibration
    monitor.restart()
    knocked = plane_cloud(5.0, 0.0, 0.2 + np.radians(10.0), points=8000)
    assert monitor.update(knocked) is before  # better than none, as long as it is said
    assert "a new one is refused: the road was expected within 15 deg" in monitor.fault
    monitor.update(plane_cloud(points=8000))
    assert monitor.fault == ""


def test_a_clock_that_is_set_back_does_not_end_the_watch(plane_cloud):
    monitor = CalibrationMonitor(CONFIG)
    for k in range(6):
        _watch(monitor, plane_cloud(seed=k, points=8000), 10_000.0 + 2.5 * k)
    assert not monitor.due(int(10_013.0 * 1e9))
    assert monitor.due(int(9_000.0 * 1e9))


def test_the_standing_recording_is_not_called_moved(recording):
    monitor = CalibrationMonitor(CONFIG)
    for k in range(12):
        with np.load(recording("lidar128-velodyne-vls128") / f"scan_{k % 3}.npz") as file:
            _watch(monitor, file["xyz"], 1.0 + 2.5 * k)
    assert monitor.fault == ""
    assert monitor.nudge_deg < 0.1


def test_real_recordings_stand_where_their_notes_say(recording):
    with np.load(recording("lidar128-velodyne-vls128") / "scan_0.npz") as file:
        found = Calibrator(CalibrationConfig()).add(file["xyz"])
    assert not found.refused
    assert found.height_m == pytest.approx(2.0, abs=0.1)
    assert found.tilt_deg < 2.0
    with np.load(sorted(recording("roadside-lidar80").glob("frame_*.npz"))[0]) as file:
        found = Calibrator(CalibrationConfig()).add(file["xyz"].astype(np.float32))
    assert found.height_m == pytest.approx(3.65, abs=0.15)
