"""States of a track for any input, ids, and what happens to tracks when the fixed scene has been learned."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as how
from hypothesis import strategies as st

from services.infra_lidar.config import BackgroundConfig, InfraLidarConfig, TrackingConfig
from services.infra_lidar.pipeline import InfraLidarPipeline
from services.infra_lidar.tracking import Detections, MultiObjectTracker

T0_NS = 1_790_000_000_000_000_000
HOUR_NS = 3_600_000_000_000


def boxes(*rows: tuple[float, float, float, float, str]) -> Detections:
    """Rows of x, y, length, width and label."""
    count = len(rows)
    table = np.array([row[:4] for row in rows], float).reshape(count, 4)
    return Detections(
        np.column_stack((table[:, :2], np.full(count, 0.8))), np.column_stack((table[:, 2:], np.full(count, 1.6))),
        np.zeros(count), [row[4] for row in rows], np.full(count, 0.9), np.full(count, 50),
    )  # fmt: skip


@how(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 100_000),
    hits=st.integers(1, 6),
    confirm_s=st.sampled_from([0.0, 0.15, 0.5]),
)
def test_states_follow_from_hits_age_and_matches(seed: int, hits: int, confirm_s: float) -> None:
    """Hits are counted by the matches, age by the stamps. Confirmed without a detection = coasting, with no points."""
    rng = np.random.default_rng(seed)
    config = TrackingConfig(confirm_hits=hits, confirm_s=confirm_s)
    tracker, seen, born, stamp = MultiObjectTracker(config), Counter[int](), dict[int, int](), T0_NS
    for _ in range(25):
        stamp += int(rng.choice([50_000_000, 100_000_000, 300_000_000]))
        here = [(8.0 * k + rng.normal(0, 0.1), 0.0, 1.0, 0.6, "cyclist") for k in range(4) if rng.random() < 0.7]
        tracks = tracker.update(stamp, boxes(*here))
        seen.update(tracker.matches.keys())
        for track in tracks:
            age_s = 1e-9 * (stamp - born.setdefault(track.track_id, stamp))
            assert track.age_s == pytest.approx(age_s, abs=1e-6)
            ready = seen[track.track_id] >= config.confirm_hits and age_s >= config.confirm_s - 1e-6
            assert ready or track.state == "tentative"
            matched = track.track_id in tracker.matches
            assert (track.state == "coasting") == (track.state != "tentative" and not matched)
            assert (track.points > 0) == matched


def test_ids_are_unique_on_a_host() -> None:
    """Two sensors with their own ``first_id`` that start in the same second, and one of them again an hour later."""
    runs = []
    for first, start_ns in ((0, T0_NS), (5000, T0_NS), (0, T0_NS + HOUR_NS)):
        tracker, ids = MultiObjectTracker(TrackingConfig(first_id=first)), set()
        for number in range(60):
            tracker.update(start_ns + number * 1_000_000_000, boxes((float(40 * (number % 7)), 0.0, 4.0, 1.8, "car")))
            ids |= tracker.matches.keys()
        runs.append(ids)
    assert [len(ids) for ids in runs] == [60, 60, 60]
    assert len(set.union(*runs)) == 180


def test_when_the_scene_is_learned_only_tracks_of_fixed_objects_are_dropped() -> None:
    """A moving car, a standing one that stays visible, and a wall that is background from now on."""
    tracker = MultiObjectTracker(TrackingConfig())
    stamps = [T0_NS + number * 100_000_000 for number in range(30)]
    for number in range(15):
        goes, stands, wall = (0.8 * number, 0.0, 4.4, 1.8, "car"), (5.0, 9.0, 4.4, 1.8, "car"), (-9.0, 5.0, 3.0, 1.0)
        before = tracker.update(stamps[number], boxes(goes, stands, (*wall, "unknown")))
    tracker.forget(np.array([True, False, True]))
    after = tracker.messages()
    assert [track.track_id for track in after] == [track.track_id for track in before][:2]
    assert [track.state for track in after] == ["confirmed", "confirmed"]
    for number in range(15, 25):
        last = tracker.update(stamps[number], boxes((0.8 * number, 0.0, 4.4, 1.8, "car"), (5.0, 9.0, 4.4, 1.8, "car")))
    assert {track.track_id for track in last} == {track.track_id for track in after}
    speed = {track.track_id: track.velocity_mps[0] for track in last}
    assert speed[after[0].track_id] == pytest.approx(8.0, abs=0.3)
    assert speed[after[1].track_id] == 0.0


def test_the_rest_of_a_learned_hedge_does_not_begin_to_move() -> None:
    """Its pieces are labelled background: they update the track, which keeps standing."""
    tracker = MultiObjectTracker(TrackingConfig())
    for number in range(40):
        label = "unknown" if number < 6 else "background"
        drift = 0.0 if number < 6 else 0.25 * (number - 6)
        tracks = tracker.update(T0_NS + number * 100_000_000, boxes((drift, 0.0, 3.0, 1.0, label)))
        assert [track.velocity_mps for track in tracks] == [(0.0, 0.0, 0.0)] * len(tracks)
    assert len(tracks) == 1


def test_a_parked_car_that_is_being_uncovered_does_not_move() -> None:
    """The visible part grows from a slanted corner to the whole car: its box turns and its centre shifts by 2 m."""
    parts = [(14.7, 13.8, 2.7, 1.0, 0.62), (14.3, 14.0, 3.6, 1.6, 0.54), (13.9, 14.4, 3.1, 1.9, 1.28)]
    parts += [(13.6, 15.0, 3.9, 1.8, 1.58), (13.8, 15.0, 4.0, 1.9, 1.45), (13.8, 15.9, 2.0, 1.1, 1.6)] * 2
    tracker = MultiObjectTracker(TrackingConfig())
    for number, (x, y, length, width, yaw) in enumerate(parts):
        seen = boxes((x, y, length, width, "car"))
        seen.yaw_rad[:] = yaw
        tracks = tracker.update(T0_NS + number * 100_000_000, seen)
        assert [np.hypot(*track.velocity_mps[:2]) > 1.0 for track in tracks] == [False] * len(tracks)


def test_a_hedge_that_falls_into_other_pieces_in_every_turn_does_not_move() -> None:
    """The first piece's track gets a velocity from the next piece and runs ahead of all of them."""
    turns = [[(3.0, 5.0), (-1.0, 3.0), (1.0, 2.0)], [(2.0, 2.0), (-1.0, 5.0), (4.0, 4.0)], [(3.0, 5.0)]]
    tracker = MultiObjectTracker(TrackingConfig())
    for number in range(12):
        seen = boxes(*[(x, 0.0, length, 2.0, "large_vehicle") for x, length in turns[number % 3]])
        tracks = tracker.update(T0_NS + number * 100_000_000, seen)
        assert [track.velocity_mps for track in tracks] == [(0.0, 0.0, 0.0)] * len(tracks)


def test_a_small_kitti_drive_moves_as_one(recording) -> None:
    """Parked cars move backwards at the vehicle's speed, all alike, and keep their ids."""
    config = InfraLidarConfig(background=BackgroundConfig(enabled=False))
    pipeline, speeds, ids = InfraLidarPipeline(config), [], []
    for number, path in enumerate(sorted(recording("sequence-kitti-hdl64").glob("data_1_*.npz"))):
        with np.load(path) as sweep:
            points = np.column_stack((sweep["xyz_cm"] / 100.0, sweep["intensity"])).astype(np.float32)
        shown = [t for t in pipeline.process(T0_NS + number * 100_000_000, points).tracks.tracks if t.label == "car"]
        speeds = [t.velocity_mps[0] for t in shown if t.state == "confirmed" and t.velocity_mps[0] != 0.0]
        ids.append({t.track_id for t in shown if t.state == "confirmed" and t.velocity_mps[0] != 0.0})
    assert len(speeds) >= 6
    assert np.median(speeds) == pytest.approx(-7.4, abs=0.4)
    assert np.median(np.abs(np.array(speeds) - np.median(speeds))) < 0.4
    assert len(ids[-1] & ids[-3]) >= 0.6 * len(ids[-3])


def test_a_detection_of_low_confidence_updates_a_track_but_initiates_none() -> None:
    tracker = MultiObjectTracker(TrackingConfig(initiate_confidence=0.7))
    sure = boxes((5.0, 0.0, 4.4, 1.8, "car"))
    unsure = replace(sure, confidence=np.array([0.5]))
    assert [tracker.update(T0_NS + n * 100_000_000, unsure) for n in range(3)] == [[], [], []]
    (born,) = tracker.update(T0_NS + 300_000_000, sure)
    for n in range(4, 20):
        (track,) = tracker.update(T0_NS + n * 100_000_000, unsure)
    assert (track.track_id, track.state) == (born.track_id, "confirmed")
