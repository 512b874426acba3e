"""The fixed scene: learned, recognised again, and never in the way of an obstacle."""

import numpy as np
import pytest

from services.infra_lidar.config import BackgroundConfig
from services.infra_lidar.segmentation.background import Background, BackgroundMask

CONFIG = BackgroundConfig(learn_s=1.0, min_frames=20, azimuth_cells=360)
RINGS = 32
ELEVATION = np.radians(np.linspace(-30, 5, RINGS))
AZIMUTH = np.radians(np.arange(0.25, 360, 0.5))
NO_SURFACE = np.zeros((4, 3), np.float32)


def _frame(seed, wall_m=30.0, things=(), height_m=5.0, noise_m=0.02):
    """A road below and a round wall, with boxes (azimuth deg from, to, range m, top m) before them: (N, 5)."""
    rng = np.random.default_rng(seed)
    azimuth, elevation = np.meshgrid(AZIMUTH + rng.normal(0, 1e-3, len(AZIMUTH)), ELEVATION, indexing="ij")
    road_m = np.where(elevation < -0.02, height_m / np.maximum(-np.sin(elevation), 1e-3), np.inf)
    range_m = np.minimum(road_m, wall_m / np.cos(elevation))
    for first, last, distance, top in things:
        here = (np.degrees(azimuth) % 360 >= first) & (np.degrees(azimuth) % 360 <= last)
        height = height_m + distance * np.tan(elevation)
        hit = here & (height >= 0) & (height <= top) & (distance / np.cos(elevation) < range_m)
        range_m = np.where(hit, distance / np.cos(elevation), range_m)
    range_m = range_m + rng.normal(0, noise_m, range_m.shape)
    ring = np.broadcast_to(np.arange(RINGS), range_m.shape)
    flat = range_m * np.cos(elevation)
    columns = [flat * np.cos(azimuth), flat * np.sin(azimuth), range_m * np.sin(elevation), 0 * flat, ring]
    return np.stack([c.ravel() for c in columns], axis=1).astype(np.float32)


def _is_thing(points, distance_m):
    return np.abs(np.hypot(points[:, 0], points[:, 1]) - distance_m) < 0.3


def _learned(things_at=lambda k: (), users=lambda points: np.zeros(len(points), bool), frames=25):
    background = Background(CONFIG)
    for k in range(frames):
        points = _frame(k, things=things_at(k))
        if background.model is None:
            ground = points[:, 2] < -4.8
            background.learn(int(k * 1e8), points, ground, users(points), NO_SURFACE)
    assert background.model is not None
    return background


def _background_mask(background, points):
    foreground = background.subtract_background(points, 2.5)
    assert foreground is not None
    return BackgroundMask(points, background.model, foreground.index)


def test_an_empty_scene_is_background_after_learning():
    background = _learned()
    points = _frame(100)
    foreground, background_mask = background.subtract_background(points, 2.5), _background_mask(background, points)
    assert foreground.background_ratio == background_mask.mask.mean() > 0.97
    road = points[:, 2] < -4.8
    assert (background_mask.road == road)[background_mask.mask].mean() > 0.99
    assert np.array_equal(foreground.index, np.flatnonzero(~background_mask.mask))
    assert np.array_equal(foreground.points, points[foreground.index, :3])


@pytest.mark.parametrize(("wall_m", "share"), [(2.0, 1.0), (30.0, 1.0), (250.0, 1.0), (510.0, 1.0), (600.0, 0.0)])
def test_a_wall_is_background_at_any_distance_that_is_kept(wall_m, share):
    """Two bytes in steps of 8 mm reach to 524 m; what is beyond stays visible, it does not come back as near."""
    background = Background(CONFIG)
    for k in range(25):
        points = _frame(k, wall_m)
        if background.model is None:
            background.learn(int(k * 1e8), points, points[:, 2] < -4.8, np.zeros(len(points), bool), NO_SURFACE)
    points = _frame(99, wall_m)
    wall = points[:, 2] > 0.0
    assert _background_mask(background, points).mask[wall].mean() == pytest.approx(share, abs=0.01)


def test_an_obstacle_that_stops_is_never_hidden():
    background = _learned()
    for k in range(200, 300):
        points = _frame(k, things=((100, 106, 15.0, 1.7),))
        thing = _is_thing(points, 15.0) & (points[:, 2] > -4.6)
        assert thing.sum() > 20
        assert (~_background_mask(background, points).mask[thing]).mean() > 0.98


def test_a_queue_at_a_red_light_is_not_learned():
    background = _learned(things_at=lambda k: ((100, 106, 15.0, 1.7),) if k % 5 < 3 else ())
    points = _frame(300, things=((100, 106, 15.0, 1.7),))
    thing = _is_thing(points, 15.0) & (points[:, 2] > -4.6)
    assert (~_background_mask(background, points).mask[thing]).mean() > 0.98


def test_a_car_parked_while_learning_stays_visible_if_it_was_recognised_as_one():
    parked = (200, 212, 12.0, 1.5)
    background = _learned(lambda k: (parked,), lambda p: _is_thing(p, 12.0) & (p[:, 2] > -4.8))
    points = _frame(300, things=(parked,))
    thing = _is_thing(points, 12.0) & (points[:, 2] > -4.7)
    assert (~_background_mask(background, points).mask[thing]).mean() > 0.98


def test_a_parked_car_stays_visible_though_a_bus_stands_before_it_as_learning_ends():
    parked, bus = (200, 212, 12.0, 1.5), (195, 217, 8.0, 3.0)
    background = _learned(
        lambda k: (parked, bus) if k >= 19 else (parked,), lambda p: _is_thing(p, 12.0) & (p[:, 2] > -4.8)
    )
    points = _frame(300, things=(parked,))
    thing = _is_thing(points, 12.0) & (points[:, 2] > -4.7)
    assert (~_background_mask(background, points).mask[thing]).mean() > 0.98


def test_who_passes_as_learning_ends_leaves_no_hole():
    passing = (100, 106, 15.0, 1.7)
    background = _learned(lambda k: (passing,) if k >= 19 else (), lambda p: _is_thing(p, 15.0) & (p[:, 2] > -4.8))
    points = _frame(300)
    there = np.abs(np.degrees(np.arctan2(points[:, 1], points[:, 0])) - 103.0) < 3.0
    assert _background_mask(background, points).mask[there].mean() > 0.97


def test_a_wall_that_is_taken_for_a_car_now_and_then_is_background():
    turn = iter(range(1000))
    background = _learned(users=lambda p: _is_thing(p, 30.0) & (next(turn) % 5 == 0))
    assert _background_mask(background, _frame(300)).mask.mean() > 0.97


def test_what_appears_behind_the_background_is_foreground():
    background = _learned()
    points = _frame(300)
    far = (np.hypot(points[:, 0], points[:, 1]) > 29) & (points[:, 1] > 25)
    points[far, :3] *= 1.5  # a gate in the wall has been opened
    assert not _background_mask(background, points).mask[far].any()


def test_another_scene_does_not_pass_for_the_learned_one():
    background = _learned()
    moved = _frame(300, wall_m=24.0, height_m=4.0)
    assert background.subtract_background(moved, 2.5) is None
    for k in range(30):
        background.subtract_background(_frame(k, wall_m=24.0, height_m=4.0), 2.5)
    assert background.lost
    background.restart()
    assert not background.lost
    assert background.model is None


def test_a_stored_model_is_recognised_on_the_first_frame_or_not_used():
    model = _learned().model
    same = Background(CONFIG, stored=model)
    same.match_stored_model(_frame(500))
    assert same.model is model
    other = Background(CONFIG, stored=model)
    other.match_stored_model(_frame(500, wall_m=24.0, height_m=4.0))
    assert other.model is None


@pytest.mark.parametrize("columns", [3, 4])
def test_clouds_without_rings_are_told_apart_by_elevation(columns):
    background = Background(CONFIG)
    for k in range(25):
        points = _frame(k)[:, :columns].copy()
        if background.model is None:
            no = np.zeros(len(points), bool)
            background.learn(int(k * 1e8), points, points[:, 2] < -4.8, no, NO_SURFACE)
    points = _frame(100, things=((100, 106, 15.0, 1.7),))[:, :columns].copy()
    is_background = _background_mask(background, points).mask
    thing = _is_thing(points, 15.0) & (points[:, 2] > -4.6)
    assert (~is_background[thing]).mean() > 0.98
    assert is_background.mean() > 0.8


def test_no_returns_are_neither_obstacle_nor_background():
    background = _learned()
    points = _frame(100)
    points[:50, :3] = 0.0
    points[50:60, :3] = np.nan
    foreground, background_mask = background.subtract_background(points, 2.5), _background_mask(background, points)
    assert not np.isin(np.arange(60), foreground.index).any()
    assert not background_mask.mask[:60].any()
    assert not background_mask.road[:60].any()
    assert foreground.returns == len(points) - 60
