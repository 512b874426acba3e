"""A revolution as range image and as points gives the same results in every step."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.infra_lidar.frames import revolutions
from services.infra_lidar.config import BackgroundConfig, InfraLidarConfig
from services.infra_lidar.input.range_image import RangeImage, count_of, points_of, sample_of
from services.infra_lidar.input.velodyne import Vls128Parser
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.segmentation.background import RINGS, Background, BackgroundMask, Grid, locate
from tests.infra_lidar.made_packets import revolutions_of

COLUMNS = 360


def _image(seed, rows=40, width=32, banks=4, empty=0.2):
    """Banks that take turns at random headings; beams that look anywhere and measure from beside the axis."""
    rng = np.random.default_rng(seed)
    range_m = rng.uniform(1.0, 90.0, (rows, width)).astype(np.float32)
    range_m[rng.random(range_m.shape) < empty] = 0.0
    heading = rng.uniform(-np.pi, np.pi, rows)
    away, up = rng.uniform(-0.1, 0.1, banks * width), rng.uniform(-0.5, 0.3, banks * width)
    beams = np.stack([
        np.cos(up) * np.cos(away), np.cos(up) * np.sin(away), np.sin(up),
        *rng.uniform(-0.05, 0.05, (3, banks * width)), rng.permutation(banks * width),
    ])  # fmt: skip
    return RangeImage(
        range_m, rng.integers(0, 256, range_m.shape).astype(np.uint8), np.cos(heading).astype(np.float32),
        np.sin(heading).astype(np.float32), (np.arange(rows) % banks).astype(np.uint8), beams.astype(np.float32),
    )  # fmt: skip


def _plain_points(image):
    """The same by numpy, in double precision: turn what is before the head by its heading."""
    rows, width = image.range_m.shape
    beam = image.bank[:, None].astype(int) * width + np.arange(width)
    r = image.range_m.astype(float)[..., None]
    ahead = r * image.beams[:3].T[beam] + image.beams[3:6].T[beam]
    turn = np.zeros((rows, 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = image.cos
    turn[:, 0, 1], turn[:, 1, 0], turn[:, 2, 2] = -image.sin, image.sin, 1.0
    xyz = np.einsum("rij,rwj->rwi", turn, ahead)
    points = np.concatenate([xyz, image.intensity[..., None], image.beams[6][beam][..., None]], axis=2)
    return np.where(r > 0, points, 0.0).reshape(-1, 5)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), rows=st.integers(0, 40))
def test_points_are_ranges_along_beams_turned_with_the_head(seed, rows):
    image = _image(seed, rows)
    points = points_of(image)
    np.testing.assert_allclose(points, _plain_points(image), atol=1e-4)
    assert len(points) == len(image) == rows * 32
    assert count_of(image) == image.returns == np.count_nonzero(points.any(axis=1))
    assert count_of(points) == len(points)


@pytest.mark.parametrize("every", [1, 13])
def test_a_sample_has_whole_rows_and_only_returns(every):
    image = _image(3, rows=53)
    kept = image.points.reshape(53, 32, 5)[::every].reshape(-1, 5)
    np.testing.assert_array_equal(sample_of(image, every), kept[kept.any(axis=1)])
    np.testing.assert_array_equal(sample_of(image.points, every), image.points[::every])


@pytest.mark.parametrize(("width", "banks"), [(32, 4), (128, 8)])  # banks of lasers; firing orders of all lasers
@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), rows=st.integers(1, 40))
def test_cells_go_by_heading_and_beam(width, banks, seed, rows):
    image = _image(seed, rows, width, banks)
    cell, range_m = locate(image, Grid(COLUMNS, RINGS))
    column = (np.arctan2(image.sin, image.cos) + np.pi) * COLUMNS / (2 * np.pi)
    plainly = np.abs(column - np.round(column)) > 1e-3  # not on a border
    beam = (image.bank[:, None].astype(int) * width + np.arange(width)) % RINGS
    expected = np.where(image.range_m > 0, np.floor(column)[:, None] * RINGS + beam, -1)
    np.testing.assert_array_equal(cell.reshape(rows, width)[plainly], expected[plainly])
    np.testing.assert_array_equal(range_m, image.range_m.ravel())


def _room(seed, things=()):
    """A road below and a round wall, things (azimuth deg from, to, range m) before them; 32 beams, head at the z axis,
    cells of the background in the middle of which it measures."""
    rng, up = np.random.default_rng(seed), np.radians(np.linspace(-30, 5, 32))
    heading = np.radians(np.arange(-180, 180) + 0.5)
    road_m = np.where(up < -0.02, 5.0 / np.maximum(-np.sin(up), 1e-3), np.inf)
    range_m = np.tile(np.minimum(road_m, 30.0 / np.cos(up)), (360, 1))
    for first, last, distance in things:
        here = (np.degrees(heading) >= first) & (np.degrees(heading) <= last)
        range_m[here] = np.minimum(range_m[here], distance)
    range_m = (range_m + rng.normal(0, 0.02, range_m.shape)).astype(np.float32)
    range_m[rng.random(range_m.shape) < 0.05] = 0.0
    none = np.zeros(32)
    beams = np.stack([np.cos(up), none, np.sin(up), none, none, none, np.arange(32)]).astype(np.float32)
    return RangeImage(
        range_m, np.zeros(range_m.shape, np.uint8), np.cos(heading).astype(np.float32),
        np.sin(heading).astype(np.float32), np.zeros(360, np.uint8), beams,
    )  # fmt: skip


def test_background_of_ranges_is_that_of_their_points():
    config = BackgroundConfig(learn_s=1.0, min_frames=20, azimuth_cells=COLUMNS)
    of_ranges, of_points = Background(config), Background(config)
    for k in range(25):
        image = _room(k)
        for background, returns in ((of_ranges, image), (of_points, image.points)):
            if background.model is None:
                ground = image.points[:, 2] < -4.8
                background.learn(k * 10**8, returns, ground, np.zeros(len(image), bool), np.zeros((4, 3), np.float32))
    steps = of_ranges.model.intervals.astype(int) - of_points.model.intervals
    assert np.abs(steps).max() <= 1  # of 8 mm: ranges that differ by a rounding may fall on either side of a step
    assert np.mean(steps != 0) < 0.001
    assert np.array_equal(of_ranges.model.is_road, of_points.model.is_road)
    assert of_ranges.model.background_ratio == pytest.approx(of_points.model.background_ratio, abs=1e-3)

    image = _room(99, things=((40, 46, 15.0), (100, 130, 2.0)))
    foreground = of_ranges.subtract_background(image, 2.5)
    by_points = of_points.subtract_background(image.points, 2.5)
    assert foreground.returns == by_points.returns == image.returns
    assert foreground.near == by_points.near > 500
    masks = [
        BackgroundMask(returns, background.model, found.index)
        for returns, background, found in ((image, of_ranges, foreground), (image.points, of_points, by_points))
    ]
    assert (masks[0].mask == masks[1].mask).mean() > 0.999
    assert (masks[0].road == masks[1].road).mean() > 0.999
    assert not masks[0].mask[image.range_m.ravel() == 0].any()
    np.testing.assert_array_equal(foreground.points, points_of(image)[foreground.index, :3])


def test_a_pipeline_sees_the_same_in_ranges_and_points():
    config = InfraLidarConfig(background=BackgroundConfig(learn_s=2.0, min_frames=20))
    of_ranges, of_points = InfraLidarPipeline(config), InfraLidarPipeline(config)
    subtracted = 0
    for k, frame in enumerate(revolutions(3, objects=12, count=32, columns=600)):
        a, b = of_ranges.process(k * 10**8, frame.image), of_points.process(k * 10**8, frame.points)
        assert a.points_in == b.points_in == len(frame.points)
        assert len(a.clusters) == pytest.approx(len(b.clusters), abs=2)
        assert (a.ground[frame.place] == b.ground).mean() > 0.999
        assert (a.background[frame.place] == b.background).mean() > 0.998
        assert ((a.cluster_id[frame.place] >= 0) == (b.cluster_id >= 0)).mean() > 0.998
        nothing = np.ones(len(frame.image), bool)
        nothing[frame.place] = False
        assert not (a.ground | a.background | (a.cluster_id >= 0))[nothing].any()
        assert len(a.points_message(5000).points) > 2500
        subtracted += a.segmentation.background_subtracted and b.segmentation.background_subtracted
    assert subtracted >= 5
    assert len(a.tracks.tracks) == pytest.approx(len(b.tracks.tracks), abs=1) != 0


def test_a_frame_without_returns_is_no_clear_road():
    pipeline = InfraLidarPipeline(InfraLidarConfig())
    (revolution,) = revolutions_of(Vls128Parser(), steps=0)
    for k in range(40):
        result = pipeline.process(k * 10**8, revolution.range_image)
    assert result.points_in == 0
    assert result.state == "degraded"
    assert "only 0 returns" in result.reason


def test_beams_that_are_lost_are_missed_in_ranges():
    pipeline = InfraLidarPipeline(InfraLidarConfig(background=BackgroundConfig(learn_s=2.0, min_frames=20)))
    frames = [frame.image for frame in revolutions(3, objects=5, count=30, columns=600)]
    for k in range(120):
        image = frames[k % 30]
        if k >= 60:
            range_m = image.range_m.copy()
            range_m[:, ::3] = 0.0
            image = replace(image, range_m=range_m)
        result = pipeline.process(k * 10**8, image)
        if k == 59:
            assert (result.state, result.reason) == ("online", "")
    assert "beams are lost" in result.reason


@pytest.mark.parametrize("width", [0, 48, 256])
def test_rows_of_another_width_are_refused(width):
    row, turn = np.zeros((2, width), np.float32), np.zeros(2, np.float32)
    with pytest.raises(ValueError, match=f"rows of {width} ranges, expected a number that divides 128"):
        RangeImage(row, row.astype(np.uint8), turn, turn, np.zeros(2, np.uint8), np.zeros((7, 256), np.float32))
