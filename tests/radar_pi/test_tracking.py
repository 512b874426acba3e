"""Life of a track: confirmation, gates, approach, coasting, deletion."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import pytest

from services.radar_pi.config import DetectionConfig, TrackingConfig
from services.radar_pi.detection import Detection
from services.radar_pi.tracking import Track, Tracker

PERIOD_S = 0.1


def tracker(v_max_mps: float = 5.15) -> Tracker:
    return Tracker(TrackingConfig(), DetectionConfig(), v_max_mps)


def seen(range_m: float, velocity_mps: float = 0.0, azimuth_rad: float | None = 0.0) -> Detection:
    return Detection(range_m, velocity_mps, azimuth_rad, 30.0)


def run(tracker: Tracker, frames: list[list[Detection]], first: int = 0) -> list[list[Track]]:
    return [deepcopy(tracker.update(round((first + i) * PERIOD_S * 1e9), frame)) for i, frame in enumerate(frames)]


def moving(start_m: float, velocity_mps: float, frames: int) -> list[list[Detection]]:
    return [[seen(start_m + velocity_mps * PERIOD_S * i, velocity_mps)] for i in range(frames)]


def test_three_frames_in_a_row_confirm_creation_included() -> None:
    assert [len(tracks) for tracks in run(tracker(), moving(3.0, 0.0, 4))] == [0, 0, 1, 1]


def test_a_miss_before_confirmation_starts_over() -> None:
    frames = [[seen(3.0)], [seen(3.0)], [], [seen(3.0)], [seen(3.0)], [seen(3.0)]]
    assert [len(tracks) for tracks in run(tracker(), frames)] == [0, 0, 0, 0, 0, 1]


def test_three_misses_delete_and_two_do_not() -> None:
    frames = [*moving(3.0, 0.0, 3), [], [], [seen(3.0)], [], [], []]
    history = run(tracker(), frames)
    assert [len(tracks) for tracks in history] == [0, 0, 1, 1, 1, 1, 1, 1, 0]
    assert {track.track_id for tracks in history for track in tracks} == {1}


@pytest.mark.parametrize("velocity_mps", [-4.0, -1.4, -0.42, 0.5, 4.0])
def test_one_id_at_any_speed(velocity_mps: float) -> None:
    start_m = 6.0 if velocity_mps < 0 else 0.4
    frames = int(5.6 / abs(velocity_mps) / PERIOD_S)
    history = run(tracker(), moving(start_m, velocity_mps, frames))
    assert all(len(tracks) == 1 for tracks in history[2:])
    assert {track.track_id for tracks in history[2:] for track in tracks} == {1}
    assert history[-1][0].velocity_mps == pytest.approx(velocity_mps, abs=0.02)
    assert history[-1][0].range_m == pytest.approx(frames_end(start_m, velocity_mps, frames), abs=0.02)


def frames_end(start_m: float, velocity_mps: float, frames: int) -> float:
    return start_m + velocity_mps * PERIOD_S * (frames - 1)


def test_two_bodies_that_cross_keep_their_ids() -> None:
    frames = [[seen(4.0 - 0.14 * i, -1.4, 0.3), seen(1.2 + 0.14 * i, 1.4, -0.3)] for i in range(20)]
    last = {track.track_id: track.velocity_mps for track in run(tracker(), frames)[-1]}
    assert last[1] == pytest.approx(-1.4, abs=0.05)
    assert last[2] == pytest.approx(1.4, abs=0.05)
    assert len(last) == 2


def test_a_velocity_beyond_the_limit_is_unfolded_by_the_track() -> None:
    """A body that speeds up over v_max shows up on the other side; the track follows."""
    v_max = 1.27
    speeds = [-1.1 - 0.05 * i for i in range(10)]
    ranges = 4.0 + PERIOD_S * np.cumsum(speeds)
    frames = [[seen(float(r), (v + v_max) % (2 * v_max) - v_max)] for r, v in zip(ranges, speeds, strict=True)]
    last = run(tracker(v_max), frames)[-1]
    assert [track.track_id for track in last] == [1]
    assert last[0].velocity_mps == pytest.approx(speeds[-1], abs=0.1)


@pytest.mark.parametrize("velocity_mps", [-4.0, -2.0, -1.4, 1.4, 2.6])
def test_a_body_too_fast_for_the_waveform_is_told_from_its_alias_by_its_range(velocity_mps: float) -> None:
    v_max = 1.27
    shown = (velocity_mps + v_max) % (2 * v_max) - v_max
    start_m = 5.0 if velocity_mps < 0 else 1.0
    frames = [[seen(start_m + velocity_mps * PERIOD_S * i, shown)] for i in range(10)]
    history = run(tracker(v_max), frames)
    # A frame later than where there is no alias; six when the echo looks as if it stood, which takes more evidence
    assert all(len(tracks) == 1 for tracks in history[6 if abs(shown) < 0.15 else 3 :])
    assert {track.track_id for tracks in history for track in tracks} == {1}
    assert history[-1][0].velocity_mps == pytest.approx(velocity_mps, abs=0.1)


@pytest.mark.parametrize("bins_a_frame", [0.0, 0.5, 1.0, -2.0, 2.0])
def test_a_standing_echo_is_not_made_fast_by_its_alias(bins_a_frame: float) -> None:
    """The strongest cell of a large reflector wanders along it, as fast as 1.6 m/s; its Doppler stays 0."""
    frames = [[seen(2.5 - 0.0786 * bins_a_frame * i, 0.0)] for i in range(14)]
    history = run(tracker(1.27), frames)
    assert all(abs(track.velocity_mps) < 0.5 for tracks in history for track in tracks)


def test_a_reflector_whose_strongest_cell_jumps_at_random_hardly_ever_looks_fast() -> None:
    rng = np.random.default_rng(2)
    fast = 0
    for _ in range(200):
        ranges_m = 3.0 + np.cumsum(rng.choice([-0.157, 0.0, 0.157], 15))
        history = run(tracker(1.27), [[seen(float(r), 0.0)] for r in ranges_m])
        fast += any(abs(track.velocity_mps) > 1.0 for tracks in history for track in tracks)
    assert fast <= 2


def test_ids_are_given_to_what_is_reported_only() -> None:
    frames = [[seen(5.0)], [], [seen(2.0)], [], *moving(3.0, 0.0, 3)]
    assert run(tracker(), frames)[-1][0].track_id == 1


def test_approach_gate_opens_after_three_closing_frames() -> None:
    history = run(tracker(), moving(3.0, -1.0, 4))
    assert [[track.approaching for track in tracks] for tracks in history] == [[], [], [True], [True]]


def test_a_miss_resets_the_gate_but_not_a_running_alarm() -> None:
    frames = moving(3.0, -1.0, 8)
    frames[4] = []
    history = run(tracker(), frames)
    assert [tracks[0].approaching for tracks in history[2:]] == [True] * 6
    late = [[seen(3.0)], [seen(3.0)], [seen(3.0)], [seen(2.96, -0.4)], [], [seen(2.88, -0.4)], [seen(2.84, -0.4)]]
    assert not run(tracker(), late)[-1][0].approaching


def test_three_frames_that_do_not_close_shut_the_gate() -> None:
    standing = [[seen(2.6, 0.0)] for _ in range(8)]
    history = run(tracker(), [*moving(3.0, -1.0, 5), *standing])
    gate = [tracks[0].approaching for tracks in history[2:]]
    assert gate[0]
    assert not gate[-1]
    shut = gate.index(False)
    assert shut >= 5  # three frames with the velocity filtered to standing, at the earliest


def test_receding_and_standing_never_open_the_gate() -> None:
    for velocity_mps in (0.0, 0.1, 2.0):
        assert not run(tracker(), moving(1.0, velocity_mps, 10))[-1][0].approaching


def test_a_part_of_a_tracked_body_makes_no_second_track() -> None:
    frames = [
        [*frame, seen(frame[0].range_m + 0.3, -1.2)] if i > 3 else frame for i, frame in enumerate(moving(4, -1.0, 12))
    ]
    assert len(run(tracker(), frames)[-1]) == 1


def test_without_azimuth_none_is_reported() -> None:
    history = run(tracker(), [[seen(3.0, 0.0, None)]] * 3)
    assert history[-1][0].azimuth_rad is None
    history = run(tracker(), [[seen(3.0, 0.0, None)]] * 3 + [[seen(3.0, 0.0, 0.4)]] * 3)
    assert history[-1][0].azimuth_rad == pytest.approx(0.4, abs=0.1)


def test_frame_period_comes_from_the_stamps() -> None:
    fast = tracker()
    for i in range(6):
        confirmed = fast.update(round(i * 0.05e9), [seen(3.0 - 2.0 * 0.05 * i, -2.0)])
    assert confirmed[0].track_id == 1
    assert confirmed[0].range_m == pytest.approx(2.5, abs=0.02)
