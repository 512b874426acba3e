"""The article's tracker is a preset of ours: equal to two plain versions of it, and each of its rules reachable."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from benchmarks.article.article_tracker import ArticleTracker
from benchmarks.article.plain_infra_lidar import Tracker
from benchmarks.article.presets import ARTICLE_CLUSTERING, ARTICLE_GROUND, ARTICLE_TRACKING
from services.infra_lidar.classification.classes import LABELS
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.tracking import Detections, MultiObjectTracker
from services.infra_lidar.tracking.config import TrackingConfig
from services.infra_lidar.warm_up import made_up_revolution

T0_NS = 1_790_000_000_000_000_000


def street(rng: np.random.Generator, objects: int, frames: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Centres (K, 3) and classes (K,) of objects that move, are missed and change their class now and then."""
    place, speed = rng.uniform(-25, 25, (objects, 3)) * [1, 1, 0.02], rng.normal(0, 3, (objects, 3)) * [1, 1, 0.02]
    kind, out = rng.integers(1, 5, objects), []
    for number in range(frames):
        seen = rng.random(objects) > 0.15
        label = np.where(rng.random(objects) > 0.05, kind, rng.integers(1, 5, objects))
        out.append(((place + 0.1 * number * speed + rng.normal(0, 0.1, place.shape))[seen], label[seen]))
    return out


def as_detections(centres: np.ndarray, labels: np.ndarray, confidence: float = 0.9) -> Detections:
    count = len(labels)
    names = [LABELS[i] for i in labels]
    return Detections(centres, np.ones((count, 3)), np.zeros(count), names, np.full(count, confidence))


@pytest.mark.parametrize("seed", range(6))
def test_the_preset_equals_the_article_on_every_track_of_every_frame(seed: int) -> None:
    """Same confirmed tracks, same states, same classes, whether stacked in numpy or looped over one by one."""
    ours, stacked, looped = MultiObjectTracker(ARTICLE_TRACKING), ArticleTracker(), Tracker()
    compared = 0
    for number, (centres, labels) in enumerate(street(np.random.default_rng(seed), 30, 40)):
        tracks = ours.update(T0_NS + number * 100_000_000, as_detections(centres, labels))
        stacked.update(centres, labels)
        plain = looped.update(centres, labels)
        mine = [(*t.position_m, *t.velocity_mps, LABELS.index(t.label)) for t in tracks if t.state != "tentative"]
        first = np.column_stack((stacked.state, stacked.label))[stacked.confirmed]
        second = [(*t.x, t.label) for t in plain]
        np.testing.assert_allclose(sorted(mine), sorted(map(tuple, first)), atol=1e-9)
        np.testing.assert_allclose(sorted(mine), sorted(second), atol=1e-9)
        compared += len(mine)
    assert compared > 600


def test_its_lifecycle() -> None:
    """Confirmed at the second hit, a new track dies at its first miss, a confirmed one at its third."""
    one = as_detections(np.array([[5.0, 0.0, 0.5]]), np.array([1]))
    none = as_detections(np.zeros((0, 3)), np.zeros(0, np.int64))
    tracker, states = MultiObjectTracker(ARTICLE_TRACKING), []
    for number, frame in enumerate([one, none, one, one, none, none, one, none, none, none]):
        states.append([track.state for track in tracker.update(T0_NS + number * 100_000_000, frame)])
    t, c, k = ["tentative"], ["confirmed"], ["coasting"]
    assert states == [t, [], t, c, k, k, c, k, k, []]


def test_a_label_changes_only_if_its_mean_confidence_leads_by_the_margin() -> None:
    """With the soft class cost: in the article another class never matches, so a track has votes for one only."""
    config = msgspec.structs.replace(ARTICLE_TRACKING, classes="soft")
    place = np.array([[5.0, 0.0, 0.5]])
    for confidence, expected in ((0.70, "car"), (0.80, "pedestrian")):
        tracker = MultiObjectTracker(config)
        frames = [as_detections(place, np.array([1]), 0.6)] * 3 + [as_detections(place, np.array([4]), confidence)] * 3
        for number, frame in enumerate(frames):
            (track,) = tracker.update(T0_NS + number * 100_000_000, frame)
        assert (track.label, track.label_confidence) == (expected, pytest.approx(0.6 if expected == "car" else 0.8))


def test_another_class_is_forbidden_or_adds_cost() -> None:
    place = np.array([[5.0, 0.0, 0.5]])
    for config, count in ((ARTICLE_TRACKING, 2), (TrackingConfig(), 1)):
        tracker = MultiObjectTracker(config)
        for number in range(4):
            tracker.update(T0_NS + number * 100_000_000, as_detections(place, np.array([4])))
        assert len(tracker.update(T0_NS + 400_000_000, as_detections(place, np.array([3])))) == count


def test_the_whole_pipeline_runs_at_the_articles_settings() -> None:
    """Measured is the mean of the points, not the centre of the box."""
    config = InfraLidarConfig(ground=ARTICLE_GROUND, clustering=ARTICLE_CLUSTERING, tracking=ARTICLE_TRACKING)
    config = msgspec.structs.replace(config, background=msgspec.structs.replace(config.background, enabled=False))
    pipeline, frame = InfraLidarPipeline(config), made_up_revolution().points
    for number in range(3):
        result = pipeline.process(T0_NS + number * 100_000_000, frame)
    level = frame[:, :3] @ result.T_level_sensor[:3, :3].T + result.T_level_sensor[:3, 3]
    means = np.array([level[result.cluster_id == k].mean(axis=0) for k in range(len(result.clusters))])
    assert len(result.tracks.tracks) > 0
    for track in result.tracks.tracks:
        assert np.linalg.norm(means - track.position_m, axis=1).min() < 0.01


def test_a_detection_of_low_confidence_updates_a_track_but_initiates_none() -> None:
    config = TrackingConfig(initiate_confidence=0.7)
    sure = as_detections(np.array([[5.0, 0.0, 0.5]]), np.array([1]))
    unsure = replace(sure, confidence=np.array([0.5]))
    tracker = MultiObjectTracker(config)
    assert [tracker.update(T0_NS + n * 100_000_000, unsure) for n in range(3)] == [[], [], []]
    (born,) = tracker.update(T0_NS + 300_000_000, sure)
    for n in range(4, 20):
        (track,) = tracker.update(T0_NS + n * 100_000_000, unsure)
    assert (track.track_id, track.state) == (born.track_id, "confirmed")
