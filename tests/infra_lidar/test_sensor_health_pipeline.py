"""What a sensor that loses its sight looks like to the whole pipeline: clouds in, state and reason out."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.infra_lidar.frames import frames_of
from services.infra_lidar.config import BackgroundConfig, InfraLidarConfig, VisibilityConfig
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.sensor_health import FrameQuality

START_NS = 1_700_000_000_000_000_000
GOOD_FRAMES, BAD_FRAMES = 12, 12


def _lost_beams(points, rng):
    return points[points[:, 4] > 40]


def _covered(points, rng):
    return points[np.arctan2(points[:, 1], points[:, 0]) > -0.8]


def _rain(points, rng):
    """A third of the rays end at a drop close to the window."""
    wet = points.copy()
    rows = rng.random(len(points)) < 0.33
    distance_m = np.linalg.norm(wet[rows, :3], axis=1, keepdims=True)
    wet[rows, :3] *= rng.uniform(0.6, 2.2, (rows.sum(), 1)) / distance_m
    return wet


def _fog(points, rng):
    """Beyond 12 m hardly anything comes back."""
    return points[np.linalg.norm(points[:, :3], axis=1) < 12.0]


def _leaf(points, rng):
    return points[:400]


def _run(frame, config, spoil=None, quality=None):
    """State and reason after good frames and then bad ones."""
    pipeline, rng = InfraLidarPipeline(config), np.random.default_rng(0)
    fine = FrameQuality(packets=600)
    for k in range(GOOD_FRAMES):
        result = pipeline.process(START_NS + k * 100_000_000, frame, fine)
    assert spoil is None or (result.tracks.state, result.tracks.reason) == ("online", "")
    for k in range(GOOD_FRAMES, GOOD_FRAMES + BAD_FRAMES):
        points = frame if spoil is None else spoil(frame, rng)
        result = pipeline.process(START_NS + k * 100_000_000, points, quality or fine)
    return result.tracks.state, result.tracks.reason


UNHURRIED = InfraLidarConfig(visibility=VisibilityConfig(budget_ms=1e6))  # a busy machine is not what is tested here


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_lost_beams, "beams are lost"),
        (_covered, "directions are covered"),
        (_rain, "rain, fog or dirt"),
        (_fog, "returns a frame instead of"),
        (_leaf, "only"),
    ],
)
def test_lost_sight_is_named(scene_frame, spoil, words):
    state, reason = _run(scene_frame("open", 4).points, UNHURRIED, spoil)
    assert state == "degraded"
    assert words in reason


def test_what_is_usual_is_learned_anew_by_recalibrating(scene_frame):
    frame, pipeline = scene_frame("open", 4).points, InfraLidarPipeline(UNHURRIED)
    for k in range(GOOD_FRAMES):
        pipeline.process(START_NS + k * 100_000_000, frame)
    half = frame[::3]  # the window has been narrowed in the sensor, say
    for k in range(GOOD_FRAMES, GOOD_FRAMES + BAD_FRAMES):
        result = pipeline.process(START_NS + k * 100_000_000, half)
    assert "returns a frame instead of" in result.tracks.reason
    pipeline.recalibrate()
    assert pipeline.process(START_NS + 10**10, half).tracks.reason == ""


def test_a_beam_without_returns_in_a_range_image_is_not_counted():
    image = frames_of(7, 10, 1, columns=600)[0].image
    image.range_m[:, 0] = 0.0
    pipeline = InfraLidarPipeline(InfraLidarConfig(background=BackgroundConfig(enabled=False)))
    beams = int(np.count_nonzero((image.range_m > 0.0).any(axis=0)))
    assert pipeline.process(START_NS, image).segmentation.statistics.beams == beams


@pytest.mark.parametrize(
    ("quality", "words"),
    [
        (FrameQuality(540, packets_lost=60), "of the packets are lost"),
        (FrameQuality(300, complete=False), "incomplete"),
    ],
)
def test_losses_on_the_way_are_named(scene_frame, quality, words):
    state, reason = _run(scene_frame("open", 4).points, UNHURRIED, lambda points, rng: points, quality)
    assert state == "degraded"
    assert words in reason


def test_work_that_takes_too_long_is_named(scene_frame):
    config = InfraLidarConfig(visibility=VisibilityConfig(budget_ms=1e-3))
    state, reason = _run(scene_frame("open", 4).points, config)
    assert state == "degraded"
    assert "ms a frame" in reason
