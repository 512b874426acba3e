"""Ground: the article's rule against a slow reference, slopes, kerbs, roofs, and whole streets."""

import numpy as np
import pytest

from benchmarks.article.flat_ground import flat_surface
from benchmarks.article.presets import ARTICLE_GROUND
from services.infra_lidar.calibration.plane_fit import Calibrator
from services.infra_lidar.config import CalibrationConfig, GroundConfig
from services.infra_lidar.segmentation.ground import Ground

LEVEL = np.eye(4)


def _slow_flat_ground(points, config):
    """The article's rule, cell by cell, on level-frame points."""
    radius, angle = np.hypot(points[:, 0], points[:, 1]), np.arctan2(points[:, 1], points[:, 0])
    sectors = round(360 / config.sector_deg)
    cell = (radius / config.ring_m).astype(int) * sectors + np.minimum(
        ((angle + np.pi) / (2 * np.pi) * sectors).astype(int), sectors - 1
    )
    inside = (radius <= config.range_max_m) & (points[:, 2] >= config.height_min_m)
    inside &= points[:, 2] <= config.height_max_m
    ground = np.zeros(len(points), bool)
    for c in np.unique(cell[inside]):
        members = np.flatnonzero((cell == c) & inside)
        z, height = points[members, 2], 0.0
        if len(z) >= config.min_points:
            low = np.sort(z)[max(1, int(config.percentile * len(z)))]
            limit = config.limit_base_m + config.limit_slope * (c // sectors + 0.5) * config.ring_m
            height = low if abs(low) <= min(limit, config.limit_max_m) else 0.0
        ground[members] = (z >= height - config.below_m) & (z <= height + config.above_m)
    return ground, inside & ~ground


def _road(slope_x=0.0, slope_y=0.0, n=40_000, seed=0, reach_m=45.0):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-reach_m, reach_m, (n, 2))
    xy = xy[np.hypot(xy[:, 0], xy[:, 1]) > 3.0]
    return np.column_stack([xy, xy @ [slope_x, slope_y] + rng.normal(0, 0.02, len(xy))]).astype(np.float32)


def test_the_articles_rule_equals_its_slow_form(scene_frame):
    frame = scene_frame("open", 3)
    level = frame.points[:, :3] @ frame.T_level_sensor[:3, :3].T.astype(np.float32)
    level += frame.T_level_sensor[:3, 3].astype(np.float32)
    slow_ground, slow_rest = _slow_flat_ground(level.astype(np.float64), ARTICLE_GROUND)
    found = Ground(ARTICLE_GROUND, fit_surface=flat_surface).remove(frame.points, frame.T_level_sensor)
    rest = np.zeros(len(level), bool)
    rest[found.index] = True
    assert (found.is_ground == slow_ground).mean() > 0.999  # the histogram's centimetre decides the others
    assert (rest == slow_rest).mean() > 0.999


@pytest.mark.parametrize("kind", ["open", "level", "facade", "trees"])
@pytest.mark.parametrize("seed", [4, 5])
def test_streets_with_their_own_calibration(scene_frame, kind, seed):
    frame = scene_frame(kind, seed)
    calibration = Calibrator(CalibrationConfig()).add(frame.points)
    ground = Ground(GroundConfig())
    levelled = ground.level_only(frame.points, calibration.T_level_sensor)
    found, inside = ground.remove_levelled(levelled), levelled.cell >= 0
    truth = (frame.actor == -2) & inside
    union = ((found.is_ground | truth) & inside).sum()
    assert (found.is_ground & truth).sum() / union > 0.97
    actors = (frame.actor > 0) & inside
    assert (found.is_ground & actors).sum() / actors.sum() < 0.04


@pytest.mark.parametrize("slope", [0.0, 0.03, 0.06, -0.06])
def test_a_steep_road_is_ground_all_the_way(slope):
    road = _road(slope_x=slope)
    found = Ground(GroundConfig(limit_max_m=6.0, height_min_m=-8.0, height_max_m=8.0)).remove(road, LEVEL)
    assert found.is_ground.mean() > 0.98


def test_a_kerb_is_ground_and_a_car_roof_is_not():
    road = _road()
    raised = road[:, 0] > 12.0
    road[raised, 2] += 0.14
    rng = np.random.default_rng(5)
    roof = np.column_stack([rng.uniform(-11, -5, 1500), rng.uniform(-3, 3, 1500), rng.normal(1.45, 0.02, 1500)])
    cloud = np.vstack([road[~((road[:, 0] < -5) & (road[:, 0] > -11) & (np.abs(road[:, 1]) < 3))], roof])
    found = Ground(GroundConfig()).remove(cloud.astype(np.float32), LEVEL)
    assert found.is_ground[: -len(roof)].mean() > 0.98
    assert found.is_ground[-len(roof) :].mean() < 0.01


def test_heights_above_the_road_follow_its_slope():
    road = _road(slope_x=0.05)
    rng = np.random.default_rng(2)
    box = np.column_stack([rng.uniform(19, 23, 400), rng.uniform(-1, 1, 400), np.zeros(400)])
    above = rng.uniform(0.3, 1.5, 400)
    box[:, 2] = box[:, 0] * 0.05 + above
    ground = Ground(GroundConfig())
    found = ground.remove(np.vstack([road, box]).astype(np.float32), LEVEL)
    index = found.index[found.index >= len(road)] - len(road)
    error = found.points[:, 3][found.index >= len(road)] - above[index]
    assert np.abs(error).max() < 0.06
    assert ground.road_height(np.array([20.0]), np.array([0.0]))[0] == pytest.approx(1.0, abs=0.06)


def test_points_under_the_road_are_no_obstacle_unless_asked_for():
    road = _road(n=20_000)
    hole = np.column_stack([np.full(50, 10.0), np.linspace(-1, 1, 50), np.full(50, -0.8)])
    cloud = np.vstack([road, hole]).astype(np.float32)
    kept = Ground(GroundConfig(keep_below=True)).remove(cloud, LEVEL)
    dropped = Ground(GroundConfig(keep_below=False)).remove(cloud, LEVEL)
    assert np.isin(np.arange(len(road), len(cloud)), kept.index).all()
    assert not np.isin(np.arange(len(road), len(cloud)), dropped.index).any()
    assert not dropped.is_ground[len(road) :].any()


def test_no_returns_and_nonsense_are_neither_ground_nor_rest():
    road = _road(n=5000)
    odd = np.array([[0, 0, 0], [np.nan, 1, 1], [np.inf, 0, 0], [1e6, 0, 0], [0.1, 0.1, 0.1]], np.float32)
    ground = Ground(GroundConfig())
    levelled = ground.level_only(np.vstack([road, odd]), LEVEL)
    found = ground.remove_levelled(levelled)
    assert not found.is_ground[-5:].any()
    assert not (found.index >= len(road)).any()
    assert levelled.returns == len(road)


def test_an_empty_frame():
    found = Ground(GroundConfig()).remove(np.zeros((0, 3), np.float32), LEVEL)
    assert len(found.index) == len(found.is_ground) == 0


def test_points_need_not_lie_row_by_row():
    """A slice or a transpose of a larger array is levelled as its copy is."""
    cloud = np.random.default_rng(3).uniform([-20, -20, -1], [20, 20, 1], (500, 3)).astype(np.float32)
    whole = np.ascontiguousarray(np.hstack([cloud, cloud]))
    expected = Ground(GroundConfig()).level_only(cloud, LEVEL).z
    for same in (whole[:, :3], np.asfortranarray(cloud), cloud.astype(np.float64)):
        np.testing.assert_array_equal(Ground(GroundConfig()).level_only(same, LEVEL).z, expected)


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.04, -0.02)])
def test_ground_by_a_road_map_is_that_by_the_surface_it_was_made_from(slope):
    config = GroundConfig(height_max_m=6.0, range_max_m=40.0)
    ground, rng = Ground(config), np.random.default_rng(2)
    ground.remove(_road(*slope), LEVEL)
    surface = ground.surface
    x, y = rng.uniform(-50.0, 50.0, (2, 5000)).astype(np.float32)
    road_m = ground.road_height(x, y)
    above_m = rng.uniform(-1.0, 8.0, len(x)).astype(np.float32)
    source = np.arange(len(x), dtype=np.int32) * 3

    points = np.column_stack((x, y, road_m + above_m))
    found = ground.remove_ground_with_map(points, source, LEVEL, surface)
    inside = (np.hypot(x, y) <= config.range_max_m) & (road_m + above_m <= config.height_max_m)
    on_road = inside & (above_m >= -config.below_m) & (above_m <= config.above_m)
    off_m = 0.05 + 0.4 * np.hypot(*slope)  # across half a square, and where the planes of two cells meet
    near_a_limit = np.abs(np.hypot(x, y) - config.range_max_m) < 0.4  # half a diagonal of a square
    for limit_m in (-config.below_m, config.above_m):
        near_a_limit |= np.abs(above_m - limit_m) < off_m
    assert near_a_limit.mean() < 0.1
    assert np.array_equal(found.is_ground[~near_a_limit], on_road[~near_a_limit])

    expected = inside & (above_m > config.above_m)
    rest = np.isin(source, found.index)
    assert np.array_equal(rest[~near_a_limit], expected[~near_a_limit])
    assert np.array_equal(found.points[:, :3], points[rest])
    assert (
        np.percentile(np.abs(found.points[:, 3] - above_m[rest]), 98) < off_m
    )  # the others lie where planes are a step apart

    ground.remove(_road(0.0, 0.1), LEVEL)  # the road of another frame does not replace the map
    again = ground.remove_ground_with_map(points, source, LEVEL, surface)
    assert np.array_equal(again.index, np.array(source[rest]))
