"""MOTA and IDF1 of the generated scenes by hand."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.datasets.tracking_metrics import TrackingScore


def feed(
    score: TrackingScore, truths: dict[int, float], tracks: dict[int, float], ignored: tuple[int, ...] = ()
) -> None:
    score.add(
        np.array(list(truths)), np.array([[x, 0.0] for x in truths.values()]).reshape(-1, 2), np.full(len(truths), 1.0),
        np.array([truth in ignored for truth in truths], bool), np.array(list(tracks), int),
        np.array([[x, 0.0] for x in tracks.values()]).reshape(-1, 2),
    )  # fmt: skip


def test_perfect_tracks() -> None:
    score = TrackingScore()
    for _ in range(5):
        feed(score, {1: 0.0, 2: 5.0}, {11: 0.1, 12: 5.1})
    assert (score.mota, score.idf1, score.switches) == (1.0, 1.0, 0)


def test_a_switch_in_the_middle_halves_idf1() -> None:
    score = TrackingScore()
    for frame in range(10):
        feed(score, {1: 0.0}, {11 if frame < 5 else 12: 0.0})
    assert score.switches == 1
    assert score.mota == pytest.approx(0.9)
    assert score.idf1 == pytest.approx(2 * 5 / 20)


def test_misses_and_false_tracks() -> None:
    score = TrackingScore()
    feed(score, {1: 0.0, 2: 5.0}, {11: 0.0, 13: 50.0})
    assert (score.misses, score.false) == (1, 1)
    assert score.mota == 0.0
    assert score.idf1 == pytest.approx(2 * 1 / 4)


def test_a_known_pair_is_kept_although_another_is_nearer() -> None:
    score = TrackingScore()
    feed(score, {1: 0.0}, {11: 0.0})
    feed(score, {1: 0.0}, {11: 0.8, 12: 0.1})
    assert (score.switches, score.false) == (0, 1)


def test_ignored_truth_neither_counts_nor_makes_its_track_false() -> None:
    score = TrackingScore()
    feed(score, {1: 0.0, 2: 9.0}, {11: 0.0, 12: 9.0}, ignored=(2,))
    assert (score.truths, score.misses, score.false, score.tracks_shown) == (1, 0, 0, 1)


def test_empty_frames() -> None:
    score = TrackingScore()
    feed(score, {}, {})
    feed(score, {1: 0.0}, {})
    assert (score.truths, score.misses, score.idf1) == (1, 1, 0.0)
