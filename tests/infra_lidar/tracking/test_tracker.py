"""The tracker on small synthetic scenes: identities, gaps, classes, lifetimes, movement."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.messages import ObjectTrack
from services.infra_lidar.config import TrackingConfig
from services.infra_lidar.tracking import Detections, MultiObjectTracker

T0_NS = 1_790_000_000_000_000_000
CAR, PERSON = (4.4, 1.8, 1.5), (0.5, 0.5, 1.7)


def detections(
    *places: tuple[float, float], size: tuple[float, float, float] = CAR, label: str = "car", confidence: float = 0.9
) -> Detections:
    count = len(places)
    return Detections(
        position_m=np.array([[x, y, size[2] / 2] for x, y in places]).reshape(count, 3),
        size_m=np.tile(size, (count, 1)).reshape(count, 3),
        yaw_rad=np.zeros(count),
        labels=[label] * count,
        confidence=np.full(count, confidence),
    )


def run(
    frames: list[Detections], config: TrackingConfig | None = None, period_s: float = 0.1
) -> list[list[ObjectTrack]]:
    tracker = MultiObjectTracker(config or TrackingConfig())
    return [tracker.update(T0_NS + round(i * period_s * 1e9), frame) for i, frame in enumerate(frames)]


def test_a_moving_car_keeps_its_id_and_gets_its_velocity() -> None:
    out = run([detections((-20.0 + 0.8 * i, 3.0)) for i in range(30)])
    assert {track.track_id for tracks in out for track in tracks} == {out[0][0].track_id}
    last = out[-1][0]
    assert last.state == "confirmed"
    assert last.velocity_mps[:2] == pytest.approx((8.0, 0.0), abs=0.3)
    assert last.position_m[:2] == pytest.approx((-20 + 0.8 * 29, 3.0), abs=0.1)
    assert last.label == "car"
    assert last.age_s == pytest.approx(2.9)
    assert np.all(np.linalg.eigvalsh(np.array(last.covariance)) > 0)


def test_confirmation_needs_hits_and_time() -> None:
    states = [tracks[0].state for tracks in run([detections((10.0, 0.0))] * 5)]
    assert states == ["tentative", "tentative", "confirmed", "confirmed", "confirmed"]


def test_an_object_seen_every_other_frame_is_tracked() -> None:
    out = run([detections((10.0, 0.0)) if i % 2 == 0 else detections() for i in range(12)])
    assert out[-2][0].state == "confirmed"
    assert len({track.track_id for tracks in out for track in tracks}) == 1


def test_a_moving_object_seen_every_other_frame_is_moving() -> None:
    out = run([detections((0.8 * i, 0.0)) if i % 2 == 0 else detections() for i in range(21)])
    assert len({track.track_id for tracks in out for track in tracks}) == 1
    assert out[-1][0].velocity_mps[0] == pytest.approx(8.0, abs=0.5)


def test_coasting_is_flagged_and_ends_after_its_time() -> None:
    config = TrackingConfig(coast_s=0.6)
    out = run([detections((0.8 * i, 0.0)) for i in range(10)] + [detections()] * 10, config)
    states = [tracks[0].state if tracks else None for tracks in out]
    assert states[10:16] == ["coasting"] * 6
    assert states[16:] == [None] * 4
    assert out[15][0].position_m[0] > out[10][0].position_m[0] + 3.0
    assert out[15][0].covariance[0][0] > out[9][0].covariance[0][0]


@pytest.mark.parametrize("period_s", [0.05, 0.1, 0.2])
def test_lifetimes_are_seconds_at_every_rate(period_s: float) -> None:
    before = [detections((10.0, 0.0))] * round(2 / period_s)
    out = run([*before, *([detections()] * round(1.2 / period_s))], TrackingConfig(coast_s=0.6), period_s)
    alive = [len(tracks) for tracks in out[len(before) :]]
    assert sum(alive) * period_s == pytest.approx(0.6, abs=1e-6)


def test_a_late_frame_moves_the_prediction_by_the_real_time() -> None:
    tracker = MultiObjectTracker(TrackingConfig())
    stamps = [0.0, 0.1, 0.2, 0.3, 0.4, 0.9, 1.0]  # 0.5 s are missing
    ids = set()
    for t in stamps:
        (track,) = tracker.update(T0_NS + round(t * 1e9), detections((10.0 * t, 0.0)))
        ids.add(track.track_id)
    assert len(ids) == 1


def test_crossing_people_keep_their_ids() -> None:
    steps = np.arange(40) * 0.1
    frames = [detections((-3 + 1.5 * t, 0.4), (3 - 1.5 * t, -0.4), size=PERSON, label="pedestrian") for t in steps]
    out = run(frames)
    first = {track.track_id: track.velocity_mps[0] for track in out[8]}
    last = {track.track_id: track.velocity_mps[0] for track in out[-1]}
    assert first.keys() == last.keys()
    assert all(np.sign(first[i]) == np.sign(last[i]) for i in first)


def test_votes_correct_a_wrong_first_label_without_a_new_track() -> None:
    frames = [detections((5.0, 0.0), size=PERSON, label="cyclist", confidence=0.6)] * 2
    frames += [detections((5.0, 0.0), size=PERSON, label="pedestrian", confidence=0.8)] * 8
    out = run(frames)
    assert [len(tracks) for tracks in out] == [1] * 10
    assert out[1][0].label == "cyclist"
    assert out[-1][0].label == "pedestrian"
    assert out[-1][0].track_id == out[0][0].track_id


def test_one_odd_label_does_not_change_the_class() -> None:
    frames = [detections((5.0, 0.0))] * 5 + [detections((5.0, 0.0), label="large_vehicle")] + [detections((5.0, 0.0))]
    assert {tracks[0].label for tracks in run(frames)} == {"car"}


def test_the_class_decides_between_two_equally_near_detections() -> None:
    tracker = MultiObjectTracker(TrackingConfig())
    for i in range(5):
        (before,) = tracker.update(T0_NS + i * 100_000_000, detections((0.0, 0.0), size=PERSON, label="pedestrian"))
    pair = Detections(
        position_m=np.array([[0.1, 0, 0.85], [-0.1, 0, 0.85]]), size_m=np.tile(PERSON, (2, 1)), yaw_rad=np.zeros(2),
        labels=["car", "pedestrian"], confidence=np.array([0.9, 0.9]),
    )  # fmt: skip
    tracker.update(T0_NS + 500_000_000, pair)
    assert tracker.matches[before.track_id] == 1


def test_unknown_objects_are_tracked_and_background_is_not() -> None:
    out = run([detections((5.0, 0.0), label="unknown", confidence=0.3)] * 5)
    assert out[-1][0].state == "confirmed"
    assert out[-1][0].label == "unknown"
    assert run([detections((5.0, 0.0), label="background")] * 5) == [[]] * 5


def test_background_in_between_keeps_a_track_alive() -> None:
    frames = [detections((5.0, 0.0))] * 5 + [detections((5.0, 0.0), label="background")] * 10
    out = run(frames)
    assert out[-1][0].state == "confirmed"
    assert out[-1][0].track_id == out[0][0].track_id


def test_a_parked_car_whose_visible_part_changes_stands_still() -> None:
    """Passers-by hide its far end now and then: the centre of the visible part jumps by a metre and more."""
    rng = np.random.default_rng(3)
    frames = []
    for i in range(100):
        visible = 4.4 if i < 5 else rng.choice([4.4, 3.0, 1.5])
        frames.append(
            detections((10.0 + visible / 2 + rng.normal(0, 0.03), rng.normal(0, 0.03)), size=(visible, 1.8, 1.5))
        )
    out = run(frames)
    assert len({track.track_id for tracks in out for track in tracks}) == 1
    assert all(track.velocity_mps == (0.0, 0.0, 0.0) for tracks in out for track in tracks)
    assert out[-1][0].position_m[0] == pytest.approx(12.2, abs=0.4)
    assert out[-1][0].size_m[0] == pytest.approx(4.4, abs=0.7)


def test_a_bush_that_changes_shape_at_random_never_moves() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        frames = []
        for _ in range(60):
            low, high = rng.uniform(-1.5, -0.3, 2), rng.uniform(0.3, 1.5, 2)
            middle, size = (low + high) / 2, (*(high - low), 1.2)
            frames.append(detections(tuple(middle), size=size, label="unknown"))
        moving = [track for tracks in run(frames) for track in tracks if np.hypot(*track.velocity_mps[:2]) > 1.0]
        assert moving == []


def test_a_walking_person_is_moving_within_a_second() -> None:
    rng = np.random.default_rng(5)
    out = run([
        detections((1.2 * 0.1 * i + rng.normal(0, 0.05), rng.normal(0, 0.05)), size=PERSON, label="pedestrian")
        for i in range(20)
    ])  # fmt: skip
    assert out[10][0].velocity_mps[0] == pytest.approx(1.2, abs=0.5)
    assert out[-1][0].velocity_mps[0] == pytest.approx(1.2, abs=0.4)


def test_a_car_seen_from_behind_turns_its_box_to_its_direction_of_travel() -> None:
    frames = []
    for i in range(25):
        frame = detections((0.8 * i, 0.0), size=(1.8, 0.8, 1.5))  # the rear: its long side lies across
        frames.append(replace(frame, yaw_rad=np.array([np.pi / 2])))
    out = run(frames)
    last = out[-1][0]
    assert last.yaw_rad == pytest.approx(0.0, abs=0.1)
    assert last.size_m[1] == pytest.approx(1.8, abs=0.1)


@pytest.mark.parametrize("back_s", [0.0, 1.0, 400.0, 1e9])
def test_a_step_back_of_any_size_drops_the_tracks_only(back_s: float) -> None:
    tracker = MultiObjectTracker(TrackingConfig())
    for k in range(5):
        tracker.update(T0_NS + k * 100_000_000, detections((10.0, 0.0)))
    (track,) = tracker.update(T0_NS + 400_000_000 - int(back_s * 1e9), detections((10.0, 0.0)))
    assert (track.state, track.age_s) == ("tentative", 0.0)


def test_a_step_back_in_time_begins_anew() -> None:
    tracker = MultiObjectTracker(TrackingConfig())
    for i in range(5):
        (old,) = tracker.update(T0_NS + i * 100_000_000, detections((0.0, 0.0)))
    (new,) = tracker.update(T0_NS, detections((0.0, 0.0)))
    assert new.state == "tentative"
    assert new.track_id != old.track_id


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1_000_000), count=st.integers(0, 12))
def test_nothing_breaks_on_random_input(seed: int, count: int) -> None:
    """Ids unique per frame, no detection on two tracks, all numbers finite, at most one new track per detection."""
    rng = np.random.default_rng(seed)
    tracker = MultiObjectTracker(TrackingConfig())
    known: set[int] = set()
    stamp = T0_NS
    for _ in range(15):
        stamp += int(rng.choice([1, 10_000_000, 100_000_000, 900_000_000]))
        n = int(rng.integers(0, count + 1))
        size = rng.uniform(0.01, 12, (n, 3))
        labels = rng.choice(["car", "unknown", "background", "pedestrian"], n).tolist()
        frame = Detections(rng.uniform(-10, 10, (n, 3)), size, rng.uniform(-9, 9, n), labels, rng.random(n))
        tracks = tracker.update(stamp, frame)
        ids = [track.track_id for track in tracks]
        assert len(ids) == len(set(ids))
        assert len(set(ids) - known) <= n
        assert len(set(tracker.matches.values())) == len(tracker.matches)
        known |= set(ids)
        for track in tracks:
            values = [*track.position_m, *track.velocity_mps, *track.size_m, track.yaw_rad, track.score]
            assert np.all(np.isfinite(values))
            assert np.all(np.isfinite(track.covariance))
            assert 0.0 <= track.label_confidence <= 1.0


def test_the_order_of_detections_does_not_matter() -> None:
    places = [(0.0, 0.0), (6.0, 1.0), (-5.0, 3.0)]
    results = []
    for order in itertools.permutations(range(3)):
        frames = [detections(*[(places[k][0] + 0.3 * i, places[k][1]) for k in order]) for i in range(8)]
        results.append(sorted(tuple(np.round(track.position_m, 9)) for track in run(frames)[-1]))
    assert all(result == results[0] for result in results)


def test_a_piece_of_a_tracked_car_initiates_no_track() -> None:
    whole = [detections((10.0, 0.0))] * 8
    broken = Detections(
        position_m=np.array([[9.0, 0, 0.75], [11.2, 0, 0.75]]), size_m=np.array([[2.4, 1.8, 1.5], [1.6, 1.7, 1.4]]),
        yaw_rad=np.zeros(2), labels=["car", "car"], confidence=np.array([0.9, 0.6]),
    )  # fmt: skip
    out = run([*whole, *[broken] * 8])
    assert [len(tracks) for tracks in out] == [1] * 16
    assert out[-1][0].position_m[0] == pytest.approx(10.0, abs=0.5)


def test_a_person_who_steps_out_of_a_car_initiates_one() -> None:
    car, person = detections((10.0, 0.0)), detections((10.0, 0.8), size=PERSON, label="pedestrian")
    both = Detections(
        *(np.concatenate((getattr(car, name), getattr(person, name))) for name in ("position_m", "size_m", "yaw_rad")),
        labels=["car", "pedestrian"], confidence=np.array([0.9, 0.9]),
    )  # fmt: skip
    out = run([*[car] * 8, *[both] * 8])
    assert sorted(track.label for track in out[-1]) == ["car", "pedestrian"]


def test_two_people_who_part_become_two_tracks() -> None:
    group = detections((5.0, 0.0), size=(1.2, 0.6, 1.7), label="pedestrian")
    parted = [
        detections((4.7 - 0.1 * i, 0.0), (5.3 + 0.1 * i, 0.0), size=PERSON, label="pedestrian") for i in range(12)
    ]
    out = run([*[group] * 6, *parted])
    assert [track.state for track in out[-1]] == ["confirmed", "confirmed"]


def test_a_small_object_does_not_turn_into_a_wall() -> None:
    """A hedge falls into different pieces in every frame: a track of a small one must not become a long one."""
    small, wall = detections((5.0, 0.0), size=(1.5, 0.6, 1.5)), detections((5.5, 0.0), size=(10.9, 3.3, 3.0))
    out = run([*[small] * 6, wall])
    assert sorted(track.state for track in out[-1]) == ["coasting", "tentative"]


def test_a_track_coasts_no_longer_than_it_was_observed() -> None:
    config = TrackingConfig(coast_s=2.0)
    out = run([detections((5.0, 0.0))] * 4 + [detections()] * 8, config)
    assert [len(tracks) for tracks in out[4:]] == [1, 1, 1, 0, 0, 0, 0, 0]
