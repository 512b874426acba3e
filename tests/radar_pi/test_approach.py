"""Bodies that come near: one id from the first report to arm's length, levels as the simulated truth has them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.radar.radar_accuracy import Truth, approach, settled_pipeline
from common.config import load
from common.messages import LEVELS, RadarTracks, worst
from services.radar_pi import pipeline as pipeline_module
from services.radar_pi.config import RadarConfig
from services.radar_pi.emulator.signals import simulator_waveform
from services.radar_pi.pipeline import RadarPipeline
from spotter_sim import bgt60
from spotter_sim.crossing import yard_and_street
from spotter_sim.model import Player, Scenario
from spotter_sim.motion import Errand, Ride, line
from spotter_sim.truth import RadarTruth, radar_targets
from spotter_sim.world import world_at

CONFIG = RadarConfig()
SHAPE = simulator_waveform(CONFIG.waveform)
PERIOD_NS = 100_000_000
Crossing = list[tuple[RadarTracks, tuple[RadarTruth, ...]]]


SIZES_M = {"pedestrian": None, "small car": (0.4, 0.2, 0.25), "car": (4.2, 1.8, 1.5), "truck": (8.0, 2.5, 3.0)}
HALF_M = {"pedestrian": 0.15, "small car": 0.2, "car": 2.1, "truck": 4.0}


@pytest.mark.parametrize("side_m", [0.0, 0.8, -0.8])
@pytest.mark.parametrize(
    ("body", "speed_mps", "start_m"),
    [
        ("pedestrian", 1.4, 6.2),
        ("pedestrian", 0.7, 4.0),
        ("pedestrian", 2.0, 6.2),
        ("small car", 4.0, 9.0),
        ("small car", 2.0, 8.0),
        ("car", 4.0, 11.0),
        ("car", 2.0, 8.0),
        ("truck", 3.0, 12.0),
    ],
)
def test_an_approaching_body_keeps_one_id_to_0_3_m(body: str, speed_mps: float, start_m: float, side_m: float) -> None:
    """Walkers (trunk, head, swinging limbs) and vehicles of any length, until their nearest side is at 0.28 m."""
    near = (0.2 + 0.28 + HALF_M[body], 0.0)  # the radar sits at x = 0.2
    kind, size_m = body.removeprefix("small "), SIZES_M[body]
    come = Ride(line((start_m, side_m), near), start_s=2.0, speed_mps=speed_mps, accel_mps2=50.0)
    back = Ride(line(near, (start_m, side_m)), start_s=30.0, speed_mps=3.0)
    scenario = Scenario("approach", 60.0, yard_and_street(), (Player(1, kind, Errand((come, back), 60.0), size_m),))
    pipeline = RadarPipeline(CONFIG)
    nearest = []
    for i in range(int((2.0 + come.duration_s) / 0.1)):
        message = pipeline.process(i * PERIOD_NS, bgt60.frame(scenario, i * 0.1, SHAPE))
        approaching = [track for track in message.tracks if track.approaching]
        nearest.append(min(approaching, key=lambda track: track.range_m, default=None))
    first = next(i for i, track in enumerate(nearest) if track)
    tracks = [track for track in nearest[first:] if track]
    assert len(tracks) == len(nearest) - first
    assert {track.track_id for track in tracks} == {tracks[0].track_id}
    assert tracks[-1].level == "IMMINENT"
    end_s = (len(nearest) - 1) * 0.1 - come.start_s
    true_m = np.hypot(start_m - near[0], side_m) - speed_mps * end_s + 0.28
    assert true_m - 0.1 < tracks[-1].range_m < min(true_m + 0.35, 0.9)
    speeds = [-track.velocity_mps for track in tracks[5:-2]]
    assert np.median(speeds) == pytest.approx(speed_mps, rel=0.2)


@pytest.mark.parametrize("speed_mps", [1.4, 4.0])
def test_a_point_keeps_one_id_from_first_report_to_0_3_m(speed_mps: float) -> None:
    pipeline, start_ns = settled_pipeline(CONFIG)
    frames = int(5.9 / speed_mps / 0.1)
    messages = approach(pipeline, start_ns, Truth(0.3, -speed_mps, 0.1, 35.0), frames, seed=8)
    reported = [[track.track_id for track in message.tracks] for message in messages]
    first = next(i for i, ids in enumerate(reported) if ids)
    assert first <= 3
    assert reported[first:] == [[1]] * (frames - first)
    assert messages[-1].tracks[0].range_m == pytest.approx(0.3, abs=0.06)


@pytest.mark.parametrize("speed_mps", [0.8, 1.4, 2.4])
def test_the_bench_configuration_tells_a_walker_from_its_alias(speed_mps: float) -> None:
    """+-1.27 m/s unambiguous: faster bodies show up as slower, receding ones; their range gives them away."""
    bench = load(RadarConfig, Path(pipeline_module.__file__).parent / "config_3rx_5m.toml")
    pipeline, start_ns = settled_pipeline(bench)
    messages = approach(pipeline, start_ns, Truth(0.8, -speed_mps, 0.1, 35.0), 12, seed=8)
    assert [track.track_id for track in messages[-1].tracks] == [1]
    track = messages[-1].tracks[0]
    assert track.velocity_mps == pytest.approx(-speed_mps, abs=0.05)
    assert track.range_m == pytest.approx(0.8, abs=0.05)
    assert track.level == "IMMINENT"


@pytest.fixture(scope="module")
def crossing() -> Crossing:
    """The second turn of the demonstration's scenario, when the background has settled, beside the truth."""
    frames = [bgt60.frame("crossing", i * 0.1, SHAPE) for i in range(150)]
    pipeline = RadarPipeline(CONFIG)
    messages = [pipeline.process(i * PERIOD_NS, frame) for i, frame in enumerate(2 * frames)]
    return [(message, radar_targets(world_at("crossing", i * 0.1))) for i, message in enumerate(messages[150:])]


def longest_run(flags: np.ndarray) -> int:
    """Frames in a row."""
    ends = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(int), [0]))))
    return int(max(ends[1::2] - ends[::2], default=0))


def test_levels_of_the_demonstration_are_those_of_the_truth(crossing: Crossing) -> None:
    """Late by the frames that a gate asks for, held as long as it takes to shut it, and not a frame more."""
    reported = np.array([LEVELS.index(message.level) for message, _ in crossing])
    true = np.array([LEVELS.index(worst(*(target.level for target in targets))) for _, targets in crossing])
    assert np.mean(reported == true) > 0.9
    gate = CONFIG.tracking.approach_frames  # confirmation takes as many at the same time
    assert longest_run(reported < true) <= gate
    assert longest_run(reported > true) <= gate - 1
    assert not np.any((reported == 0) & (true == 2))
    assert not np.any((reported == 2) & (true == 0))


def test_ranges_of_the_demonstration_are_those_of_the_truth(crossing: Crossing) -> None:
    errors = []
    for message, targets in crossing:
        closing = [target for target in targets if target.velocity_mps < -0.5]
        tracks = [track for track in message.tracks if track.approaching]
        if closing and tracks:
            errors.append(min(abs(track.range_m - closing[0].range_m) for track in tracks))
    assert len(errors) > 30
    assert np.median(errors) < 0.2
    assert np.percentile(errors, 95) < 0.45
