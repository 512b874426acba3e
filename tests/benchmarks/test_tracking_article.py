"""The article's tracker, by plain loops: equal to the plain one that loops over tracks and pairs."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.article.article_tracker import ArticleTracker
from benchmarks.article.plain_infra_lidar import Tracker


def street(rng: np.random.Generator, objects: int, frames: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Centres (K, 3) and classes (K,) of objects that move, are missed and change their class now and then."""
    place, speed = rng.uniform(-25, 25, (objects, 3)) * [1, 1, 0.02], rng.normal(0, 3, (objects, 3)) * [1, 1, 0.02]
    kind, out = rng.integers(1, 5, objects), []
    for number in range(frames):
        seen = rng.random(objects) > 0.15
        label = np.where(rng.random(objects) > 0.05, kind, rng.integers(1, 5, objects))
        out.append(((place + 0.1 * number * speed + rng.normal(0, 0.1, place.shape))[seen], label[seen]))
    return out


@pytest.mark.parametrize("seed", range(6))
def test_both_have_the_same_confirmed_tracks_in_every_frame(seed: int) -> None:
    ours, looped, compared = ArticleTracker(), Tracker(), 0
    for centres, labels in street(np.random.default_rng(seed), 30, 40):
        ours.update(centres, labels)
        plain = [(*t.x, t.label) for t in looped.update(centres, labels)]
        mine = np.column_stack((ours.tracks.state, ours.tracks.label))[ours.tracks.confirmed]
        np.testing.assert_allclose(sorted(map(tuple, mine)), sorted(plain), atol=1e-9)
        compared += len(mine)
    assert compared > 600


def test_a_track_is_confirmed_at_its_second_hit_and_ends_at_its_third_miss() -> None:
    one, none = (np.array([[5.0, 0.0, 0.5]]), np.array([1])), (np.zeros((0, 3)), np.zeros(0, np.int64))
    tracker, confirmed = ArticleTracker(), []
    for frame in [one, none, one, one, none, none, one, none, none, none]:
        tracker.update(*frame)
        confirmed.append(tracker.tracks.confirmed.tolist())
    new, known = [False], [True]
    assert confirmed == [new, [], new, known, known, known, known, known, known, []]


def test_a_detection_of_another_class_initiates_a_track() -> None:
    tracker = ArticleTracker()
    for label in (4, 4, 4, 3):
        tracker.update(np.array([[5.0, 0.0, 0.5]]), np.array([label]))
    assert sorted(tracker.tracks.label.tolist()) == [3, 4]
