"""The own speed from standing echoes: made-up detections, and the simulated yard through the whole pipeline."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.radar_pi.axes import derive_axes
from services.radar_pi.config import OwnSpeedConfig, RadarConfig
from services.radar_pi.detection import Detection
from services.radar_pi.own_speed import OwnSpeed, fit, fold
from services.radar_pi.pipeline import RadarPipeline
from services.radar_pi.source import simulator_waveform
from spotter_sim import bgt60
from spotter_sim.model import Scenario
from spotter_sim.world import world_at
from spotter_sim.yard import drive

CONFIG = OwnSpeedConfig()
AXES = derive_axes(RadarConfig().waveform)


def body(velocity_mps: float, azimuth_rad: float | None, range_m: float = 2.0) -> Detection:
    return Detection(range_m=range_m, velocity_mps=velocity_mps, azimuth_rad=azimuth_rad, snr_db=20.0)


def standing(speed_mps: float, azimuths: list[float], seed: int = 0) -> list[Detection]:
    dice = random.Random(seed)
    seen = [fold(np.array(-speed_mps * math.cos(a) + dice.gauss(0, 0.05)), AXES.v_max_mps) for a in azimuths]
    return [body(float(v), a) for v, a in zip(seen, azimuths, strict=True)]


azimuths = st.lists(st.floats(-0.9, 0.9), min_size=6, max_size=20).filter(lambda a: max(a) - min(a) > 0.5)


@given(st.floats(-4.5, 4.5), azimuths, st.integers(0, 1000))
def test_standing_echoes_give_the_speed_within_its_uncertainty(speed: float, azimuths: list[float], seed: int) -> None:
    own = fit(standing(speed, azimuths, seed), CONFIG, AXES)
    assert own is not None
    assert abs(own.speed_mps - speed) < 5 * own.sigma_mps
    assert own.sigma_mps < 0.1


@given(st.floats(0.5, 4.0), azimuths, st.lists(st.tuples(st.floats(-4, 4), st.floats(-0.9, 0.9)), max_size=3))
def test_a_few_that_move_change_nothing(speed: float, azimuths: list[float], movers: list[tuple[float, float]]) -> None:
    echoes = standing(speed, azimuths) + [body(v, a) for v, a in movers]
    own = fit(echoes, CONFIG, AXES)
    assert own is None or abs(own.speed_mps - speed) < 0.35  # none: too large a share moves


@pytest.mark.parametrize(
    "echoes",
    [
        [],
        standing(2.0, [-0.5, 0.0, 0.5]),  # three are too few
        [body(-1.0, 0.05 * i) for i in range(4)],  # one walker, in four frames
        [body(-1.0, None) for _ in range(9)],  # one receiver: no azimuth
        [body(v, a) for v, a in ((-1.0, -0.5), (2.0, 0.0), (0.5, 0.5), (-3.0, 0.3), (1.5, -0.2), (3.0, 0.1))],
        [body(2.0 * math.cos(a), a, 5.0) for a in (-0.5, -0.2, 0.1, 0.3, 0.6)],  # folded from 10 m: we drive at them
    ],
    ids=["none", "too few", "one direction", "no azimuth", "no agreement", "folded"],
)
def test_what_is_no_evidence_gives_none(echoes: list[Detection]) -> None:
    assert fit(echoes, CONFIG, AXES) is None


def static_profiles(phase_rad: float, strong_bins: int, seed: int, drift_rad: float = 0.0) -> np.ndarray:
    """(rx, chirp, bin): noise, and in some far bins an echo of this phase that turns by ``drift_rad`` in the frame."""
    rng = np.random.default_rng(seed)
    shape = (3, 64, AXES.far_bin)
    profiles = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    turning = np.exp(1j * (phase_rad + drift_rad * np.arange(64) / 64))
    profiles[:, :, AXES.far_bin - strong_bins :] += 20.0 * turning[None, :, None]
    return profiles


@pytest.mark.parametrize(
    ("second", "stands"),
    [
        ({"phase_rad": 0.1, "strong_bins": 8}, True),
        ({"phase_rad": 1.0, "strong_bins": 8}, False),  # 0.4 mm nearer
        ({"phase_rad": 0.0, "strong_bins": 8, "drift_rad": 1.0}, False),  # whole turns between the frames, not within
        ({"phase_rad": 0.1, "strong_bins": 3}, False),  # too little stands anywhere to say so
    ],
)
def test_static_echoes_that_keep_their_phase_say_that_it_stands(second: dict[str, float], stands: bool) -> None:
    own = OwnSpeed(CONFIG, AXES, 0.1)
    bins = int(second["strong_bins"])
    assert own.update(static_profiles(0.0, bins, seed=1), []) is None  # the first frame has none before it
    motion = own.update(static_profiles(seed=2, **second), [])  # type: ignore[arg-type]
    assert (motion is not None) == stands
    if motion is not None:
        assert (motion.speed_mps, motion.agreeing) == (0.0, bins)
    own.reset()
    assert own.update(static_profiles(0.0, 8, seed=3), []) is None


def driven(scenario: str | Scenario, start_s: float, frames: int) -> list[tuple[float, float | None, float | None]]:
    """(true speed, estimate, sigma) of every frame."""
    pipeline = RadarPipeline(RadarConfig())
    waveform = simulator_waveform(RadarConfig().waveform)
    rows = []
    for i in range(frames):
        at_s = start_s + 0.1 * i
        pipeline.process(10**18 + round(at_s * 1e9), bgt60.frame(scenario, at_s, waveform))
        motion = pipeline.motion()
        assert motion.speed_origin == ("" if motion.speed_mps is None else "radar")
        rows.append((world_at(scenario, at_s).vehicle_speed_mps, motion.speed_mps, motion.speed_sigma_mps))
    return rows


def test_in_the_yard_what_it_says_is_right_and_it_knows_that_it_stands() -> None:
    """While driving in the open it seldom has the four echoes that it takes: the walls are 7 m away."""
    rows = driven(drive(2.0, 0), 0.0, 372)
    standing = [speed for true, speed, _ in rows if true == 0.0]
    assert standing.count(0.0) >= len(standing) - 1
    known = [(true, speed, sigma) for true, speed, sigma in rows if true and speed is not None and sigma is not None]
    assert len(known) > 10
    errors = [abs(speed - true) for true, speed, _ in known]
    assert np.median(errors) < 0.1
    assert all(error < 4 * sigma for error, (_, _, sigma) in zip(errors, known, strict=True))
    assert not [speed for _, speed, _ in known if abs(speed) < 0.1]


def test_far_walls_that_fold_back_are_no_driving_in_reverse() -> None:
    """In this bend of yard 1 the walls beyond 7.5 m show up at 5 to 6 m, going away."""
    known = [speed for _, speed, _ in driven(drive(2.0, 1), 5.0, 18) if speed is not None]
    assert not [speed for speed in known if speed < 0.0]


def test_things_near_that_go_away_are_driving_in_reverse() -> None:
    own = fit([body(1.0 * math.cos(a), a, 2.0) for a in (-0.5, -0.2, 0.1, 0.3, 0.6)], CONFIG, AXES)
    assert own is not None
    assert own.speed_mps == pytest.approx(-1.0, abs=0.01)


def test_people_who_walk_past_a_standing_vehicle_are_not_its_own_motion() -> None:
    rows = driven("crossing", 0.0, 40)
    assert sum(speed == 0.0 for _, speed, _ in rows) > 30
    assert {speed for _, speed, _ in rows} <= {0.0, None}
