"""A recording labels itself: what moved is what it was called most, what always stood is clutter."""

import numpy as np
import pytest

from services.infra_lidar.adaptation.labels import class_of, label_site
from services.infra_lidar.adaptation.recorder import SiteRecord, TrackHistory
from services.infra_lidar.classification.classes import CLASSES

BACKGROUND, CAR, LARGE, CYCLIST, PEDESTRIAN = range(5)
CAR_BOX = (4.3, 1.8, 1.4)


def _track(votes, moved_m=30.0, lived_s=4.0, moving=1.0, hits=40):
    history = TrackHistory(0, round(lived_s * 1e9), np.zeros(3), np.array(votes, float), moved_m)
    history.frames, history.moving_frames, history.hits = 40, round(40 * moving), hits
    return history


@pytest.mark.parametrize(
    ("history", "called"),
    [
        (_track([0, 30, 5, 0, 5]), CAR),
        (_track([30, 8, 1, 0, 1]), CAR),  # mostly called background, but background does not move
        (_track([0, 20, 20, 0, 0]), None),  # of two minds
        (_track([40, 0, 0, 0, 0]), None),
        (_track([0, 40, 0, 0, 0], moved_m=3.0), None),
        (_track([0, 40, 0, 0, 0], lived_s=1.0), None),
        (_track([0, 40, 0, 0, 0], moving=0.2), None),
        (_track([0, 40, 0, 0, 0], hits=5), None),
    ],
)
def test_a_track_is_trusted_that_moved_lived_and_was_of_one_mind(history, called):
    assert class_of(history) == called


def _record(rows, tracks=None, length_s=60.0):
    """rows: (class that it is called, place x, size, standing share, track) of each cluster, one per revolution."""
    n = len(rows)
    box = np.zeros((n, 8), np.float32)
    box[:, 0] = [row[1] for row in rows]
    box[:, 3:6] = [row[2] for row in rows]
    stamps = np.linspace(0, length_s * 1e9, n).astype(np.int64)
    return SiteRecord(
        x=np.zeros((n, 3), np.float32), called=np.eye(5)[[row[0] for row in rows]], box=box, stamp_ns=stamps,
        track=np.array([row[4] for row in rows]), standing=np.array([row[3] for row in rows]), tracks=tracks or {},
        sampled_ns=stamps,
    )  # fmt: skip


def _labels(record):
    found = label_site(record)
    return dict(zip(found.rows.tolist(), [CLASSES[c] for c in found.labels], strict=True))


def test_the_hard_moments_of_a_car_are_a_car():
    tracks = {7: _track([4, 30, 6, 0, 0])}
    record = _record(
        [(CAR, 0, CAR_BOX, 0.0, 7), (LARGE, 9, CAR_BOX, 0.0, 7), (BACKGROUND, 20, CAR_BOX, 0.1, 7)], tracks
    )
    assert _labels(record) == {0: "car", 1: "car", 2: "car"}


def test_a_barrier_that_is_called_large_vehicle_is_clutter():
    barrier = (LARGE, 15.0, (12.0, 1.0, 1.5), 1.0, -1)
    assert _labels(_record([barrier] * 5)) == dict.fromkeys(range(5), "background")


def test_a_short_recording_does_not_tell_what_stands():
    assert _labels(_record([(LARGE, 15.0, (12.0, 1.0, 1.5), 1.0, -1)] * 5, length_s=10.0)) == {}


def test_a_parked_car_is_neither_clutter_nor_a_moving_car():
    assert _labels(_record([(CAR, 15.0, CAR_BOX, 1.0, -1)] * 5)) == {}


def test_a_bush_that_is_once_called_car_is_clutter():
    rows = [(BACKGROUND, 15.0, (2.0, 1.8, 1.4), 1.0, -1)] * 4 + [(CAR, 15.0, (2.0, 1.8, 1.4), 1.0, -1)]
    assert set(_labels(_record(rows)).values()) == {"background"}


@pytest.mark.parametrize("track", [3, -2])
def test_what_moved_or_shares_a_cluster_with_another_is_no_clutter(track):
    tracks = {3: _track([30, 5, 0, 0, 0], moved_m=4.0, moving=0.5)}
    assert _labels(_record([(LARGE, 15.0, (12.0, 1.0, 1.5), 1.0, track)] * 5, tracks)) == {}


def test_clusters_of_a_road_user_and_of_a_place_are_groups():
    tracks = {7: _track([0, 30, 0, 0, 0]), 8: _track([0, 30, 0, 0, 0])}
    rows = [(CAR, 0, CAR_BOX, 0.0, 7), (CAR, 5, CAR_BOX, 0.0, 8), (CAR, 9, CAR_BOX, 0.0, 7)]
    rows += [(LARGE, 40.0, (12.0, 1.0, 1.5), 1.0, -1), (LARGE, 80.0, (12.0, 1.0, 1.5), 1.0, -1)]
    groups = label_site(_record(rows, tracks)).groups
    assert groups[0] == groups[2]
    assert len(set(groups.tolist())) == 4
