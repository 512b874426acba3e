"""One vehicle, one track: pieces of a bus, parked neighbours, people beside cars."""

from __future__ import annotations

import numpy as np
import pytest

from common.messages import ObjectTrack
from services.infra_lidar.config import TrackingConfig
from services.infra_lidar.tracking import Detections, MultiObjectTracker

T0_NS = 1_790_000_000_000_000_000
Box = tuple[float, float, float, float, float, str, int]  # x, y, length, width, height, label, points


def frame(*rows: Box) -> Detections:
    table = np.array([row[:5] for row in rows], float).reshape(len(rows), 5)
    return Detections(
        np.column_stack((table[:, :2], table[:, 4] / 2)), table[:, 2:], np.zeros(len(rows)),
        [row[5] for row in rows], np.full(len(rows), 0.8), np.array([row[6] for row in rows]),
    )  # fmt: skip


def play(frames: list[Detections], config: TrackingConfig | None = None) -> tuple[list[list[ObjectTrack]], dict]:
    tracker, merged_into = MultiObjectTracker(config or TrackingConfig()), {}
    out = []
    for number, detections in enumerate(frames):
        out.append(tracker.update(T0_NS + number * 100_000_000, detections))
        merged_into |= tracker.merged
    return out, merged_into


def bus(number: int, pieces: bool) -> Detections:
    """A bus of 12 m at 8 m/s, whole, or as front, roof and rear."""
    x = 0.8 * number
    if not pieces:
        return frame((x, 0.0, 12.0, 2.5, 3.0, "large_vehicle", 400))
    return frame(
        (x + 3.0, 0.0, 6.0, 2.5, 3.0, "large_vehicle", 200),
        (x - 1.5, 0.4, 7.0, 1.2, 1.0, "large_vehicle", 60),
        (x - 4.8, 0.0, 2.4, 2.5, 2.5, "car", 50),
    )


@pytest.mark.parametrize(("begins", "every"), [(0, 2), (12, 6)])
def test_a_bus_in_pieces_is_one_track(begins: int, every: int) -> None:
    """Broken in every second frame from the first one on, or mostly, after it has been seen whole."""
    out, _ = play([bus(n, n >= begins and n % every != every - 1) for n in range(40)])
    assert [len([t for t in tracks if t.state != "tentative"]) for tracks in out[20:]] == [1] * 20
    assert len({t.track_id for tracks in out[20:] for t in tracks if t.state != "tentative"}) == 1
    assert out[-1][0].velocity_mps[0] == pytest.approx(8.0, abs=1.0)


def test_the_older_track_lives_on_with_the_better_box() -> None:
    """A roof is seen first; then the whole bus beside it, too far off the roof to match it, initiates a track."""
    roof, both = [], []
    for n in range(25):
        top = (0.8 * n - 3.5, 0.3, 4.0, 1.5, 0.6, "large_vehicle", 40)
        whole = (0.8 * n, 0.0, 10.0, 2.5, 3.0, "large_vehicle", 300)
        (roof if n < 10 else both).append(frame(top) if n < 10 else frame(top, whole))
    out, merged_into = play(roof + both)
    first = out[0][0].track_id
    assert {t.track_id for t in out[-1]} == {first}
    assert set(merged_into.values()) == {first}
    assert out[-1][0].size_m[0] == pytest.approx(10.0, abs=0.5)
    apart, _ = play(roof + both, TrackingConfig(merge_duplicates=False))
    assert len(apart[-1]) == 2


def test_a_piece_that_breaks_off_does_not_stop_a_moving_bus() -> None:
    """The rear comes apart, with most of the points and the look of a car, and its track is younger than a second."""
    frames = [bus(number, pieces=False) for number in range(20)]
    for number in range(20, 26):
        x = 0.8 * number
        front = (x + 1.5, 0.0, 9.0, 2.5, 3.0, "large_vehicle", 150)
        frames.append(frame(front, (x - 4.5, 0.0, 3.0, 2.6, 2.9, "car", 400)))
    out, merged_into = play(frames)
    assert merged_into
    for tracks in out[20:]:
        (whole,) = (track for track in tracks if track.track_id == out[19][0].track_id)
        assert whole.velocity_mps[0] == pytest.approx(8.0, abs=1.0)
        assert whole.size_m[0] > 9.0


def test_parked_neighbours_stay_two() -> None:
    side = frame((0.0, 0.0, 4.5, 1.8, 1.5, "car", 90), (0.3, 2.3, 4.5, 1.8, 1.5, "car", 90))
    merged = frame((0.1, 1.1, 4.6, 4.1, 1.5, "car", 180))
    out, merged_into = play([merged if n in (8, 9) else side for n in range(30)])
    assert merged_into == {}
    assert [len(tracks) for tracks in out] == [2] * 30


def test_a_car_that_a_bus_passes_stays() -> None:
    """It has been standing for long, and the bus's box is wide: the two do not move together."""
    frames = [
        frame((-12.0 + 0.8 * n, 0.0, 12.0, 3.4, 3.0, "large_vehicle", 400), (0.0, 2.4, 4.5, 1.8, 1.5, "car", 90))
        for n in range(35)
    ]
    out, merged_into = play(frames)
    assert merged_into == {}
    assert len({t.track_id for tracks in out for t in tracks}) == 2


@pytest.mark.parametrize("label", ["pedestrian", "cyclist"])
def test_people_are_never_merged_into_a_vehicle(label: str) -> None:
    bike = (-0.5, 0.6, 0.6, 0.5, 1.7, label, 30)
    out, merged_into = play([frame((0.0, 0.0, 4.5, 1.8, 1.5, "car", 90), bike)] * 15)
    assert merged_into == {}
    assert sorted(t.label for t in out[-1]) == sorted(["car", label])


def test_a_standing_ghost_inside_a_passing_bus_is_merged() -> None:
    """A young piece has shown no movement yet; it lies inside the bus and is merged before it is ever confirmed."""
    ghost = (14.6, 0.0, 2.4, 1.0, 0.8, "car", 15)
    passing = [frame((0.8 * n, 0.0, 12.0, 2.5, 3.0, "large_vehicle", 400), ghost) for n in range(12, 22)]
    out, merged_into = play([bus(n, False) for n in range(12)] + passing)
    assert max(len([t for t in tracks if t.state != "tentative"]) for tracks in out) == 1
    assert set(merged_into.values()) == {out[-1][0].track_id}


def walkers(*places: tuple[float, float]) -> Detections:
    return frame(*((x, y, 0.5, 0.5, 1.7, "pedestrian", 40) for x, y in places))


def test_people_who_come_together_in_one_cluster_keep_their_tracks() -> None:
    """Three walk side by side, are one cluster for a second and a half, and part again."""
    apart = [walkers((0.12 * n, -0.8), (0.12 * n, 0.0), (0.12 * n, 0.8)) for n in range(10)]
    together = [frame((0.12 * n, 0.0, 0.5, 2.1, 1.7, "car", 120)) for n in range(10, 25)]
    again = [walkers((0.12 * n, -0.8), (0.12 * n, 0.0), (0.12 * n, 0.8)) for n in range(25, 35)]
    out, _ = play(apart + together + again)
    ids = {t.track_id for t in out[5]}
    assert [{t.track_id for t in tracks} for tracks in out[5:]] == [ids] * 30
    assert {t.state for tracks in out[5:] for t in tracks} == {"confirmed"}
    assert {t.label for t in out[24]} == {"pedestrian"}
    assert sorted(t.position_m[1] for t in out[24]) == pytest.approx([-0.8, 0.0, 0.8], abs=0.25)
    off, _ = play(apart + together + again, TrackingConfig(split_groups=False))
    assert {t.track_id for t in off[-1]} != ids


def test_pieces_refer_to_the_detection_they_were_split_from() -> None:
    """Two tracks share the detection they were split from; indices are those of the caller's detections."""
    tracker = MultiObjectTracker(TrackingConfig())
    for n in range(8):
        before = tracker.update(T0_NS + n * 100_000_000, walkers((0.0, 0.4), (0.0, -0.4), (9.0, 0.0)))
    tracker.update(
        T0_NS + 800_000_000,
        frame((9.0, 0.0, 0.5, 0.5, 1.7, "pedestrian", 40), (0.0, 0.0, 1.3, 0.5, 1.7, "cyclist", 80)),
    )
    assert tracker.matches[before[2].track_id] == 0
    assert len(tracker.matches) == 2  # too near each other along the cluster, which lies across: not split
    tracker.update(
        T0_NS + 900_000_000,
        frame((9.0, 0.0, 0.5, 0.5, 1.7, "pedestrian", 40), (0.0, 0.0, 0.5, 1.3, 1.7, "cyclist", 80)),
    )
    assert [tracker.matches[track.track_id] for track in before] == [1, 1, 0]
    tracker.forget(np.array([False, True]))
    assert [track.track_id for track in tracker.messages()] == [before[2].track_id]
