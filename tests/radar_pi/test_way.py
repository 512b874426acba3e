"""The radar on a vehicle that drives: simulated chirps through the whole pipeline, and what decides about a track."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from common.messages import LEVELS, Level, Motion, RadarTracks
from services.radar_pi.config import RadarConfig
from services.radar_pi.emulator.signals import simulator_waveform
from services.radar_pi.pipeline import RadarPipeline
from services.radar_pi.tracking import Track
from services.radar_pi.way import Way
from spotter_sim import bgt60, odometry
from spotter_sim.bgt60 import Target
from spotter_sim.model import Scenario
from spotter_sim.motion import Straight
from spotter_sim.straight import box_ahead, parked_lane, passage, person_ahead
from spotter_sim.vehicle import MODEL_CAR
from spotter_tools.prove.configs import configs_of

CONFIG = RadarConfig()
SHAPE = simulator_waveform(CONFIG.waveform)
PERIOD_S = 0.1
BUMPER_M = MODEL_CAR.size_m[0] / 2


class Step(NamedTuple):
    """One frame of a drive."""

    t_s: float
    x_m: float  # of the bumper
    message: RadarTracks

    @property
    def rank(self) -> int:
        return LEVELS.index(self.message.level)


def drive(scenario: Scenario, seconds: float, *, known: bool = True, scale: float = 1.0) -> list[Step]:
    """What the radar says; the vehicle's motion is that of the simulated encoder, times ``scale``, or unknown."""
    pipeline, steps = RadarPipeline(CONFIG), []
    for i in range(round(seconds / PERIOD_S)):
        t_s = i * PERIOD_S
        world = scenario.at(t_s)
        measured = odometry.measure(world)
        motion = Motion(scale * measured.speed_mps, measured.yaw_rate_radps) if known else None
        message = pipeline.process(round(t_s * 1e9) + 10**18, bgt60.frame(scenario, t_s, SHAPE), motion)
        steps.append(Step(t_s, world.T_map_vehicle[0, 3] + BUMPER_M, message))
    return steps


def first(steps: list[Step], level: Level, obstacle_m: float) -> float:
    """How far ahead of the bumper the obstacle was when the level was first reached."""
    return next(obstacle_m - one.x_m for one in steps if one.rank >= LEVELS.index(level))


def levels(steps: list[Step]) -> set[Level]:
    return {one.message.level for one in steps}


def test_a_lane_of_parked_cars_is_safe_all_the_way() -> None:
    """Cars abreast look like one thing between them to a pair of receivers; their Doppler tells the truth."""
    assert levels(drive(parked_lane(2.0), 10.0)) == {"SAFE"}


def test_a_passage_is_safe() -> None:
    assert levels(drive(passage(1.0), 9.0)) == {"SAFE"}


def test_without_a_known_motion_the_article_decides() -> None:
    """Relative closing counts then, wherever it will pass: the same drive alarms."""
    steps = drive(parked_lane(2.0), 7.0, known=False)
    assert "IMMINENT" in levels(steps)
    assert all(one.message.motion is None for one in steps)
    assert all(track.on_way is None for one in steps for track in one.message.tracks)


@pytest.mark.parametrize(("speed_mps", "imminent_m"), [(1.0, 1.4), (2.0, 2.85), (3.0, 4.2)])
def test_a_box_in_the_way_is_imminent_as_early_as_by_the_article(speed_mps: float, imminent_m: float) -> None:
    """And stays so until it is there. CAUTION is the lidar's to give early: its bands grow with the speed."""
    at_m = 3.5 * speed_mps
    steps = drive(box_ahead(speed_mps, at_m), 2.9 + at_m / speed_mps)
    assert first(steps, "IMMINENT", at_m) >= imminent_m
    assert {one.rank for one in steps if at_m - imminent_m < one.x_m < at_m - 0.3} == {2}


@pytest.mark.parametrize("scale", [0.97, 1.03, 1.06])
def test_a_speedometer_that_is_wrong_does_not_push_a_box_off_the_way(scale: float) -> None:
    """Its own ranges and speeds tell the scale: later, but in time to stop."""
    steps = drive(box_ahead(2.0, 7.0), 6.2, scale=scale)
    assert first(steps, "IMMINENT", 7.0) >= 1.8


def test_a_box_beside_the_way_is_passed() -> None:
    assert levels(drive(box_ahead(2.0, 6.0, beside_m=0.95), 6.5)) == {"SAFE"}


@pytest.mark.parametrize(
    ("motion", "expected"),
    [
        (Straight((10.0, 5.6), -np.pi / 2, 0.68), "IMMINENT"),  # walks into the way: both are at (10, 0) after 8.2 s
        (Straight((10.0, -5.6), np.pi / 2, 0.68), "IMMINENT"),
        (Straight((12.0, 0.0), np.pi, 1.0), "IMMINENT"),  # comes
        (Straight((3.0, 0.0), 0.0, 0.6), "IMMINENT"),  # walks ahead, slower than we drive
        (Straight((6.0, 0.0), 0.0, 2.2), "SAFE"),  # walks ahead, faster
        (Straight((16.0, 1.1), np.pi, 2.0), "SAFE"),  # comes, and passes beside
    ],
)
def test_people_on_the_way_and_off_it(motion: Straight, expected: Level) -> None:
    steps = drive(person_ahead(2.0, motion), 9.0)
    assert max(levels(steps), key=LEVELS.index) == expected


def test_what_turns_out_to_stand_beside_the_way_is_on_it_for_no_more_than_some_frames() -> None:
    way, speed_mps = Way(CONFIG), 2.0
    track = Track(np.array([4.0, -speed_mps, 0.0]), np.eye(3), snr_db=20.0, has_azimuth=True, approaching=True)

    def level_after(frame: int, bearing_rad: float) -> Level:
        """The level after a frame in which the track, ever nearer, is measured at that bearing."""
        range_m = 4.0 - frame * speed_mps * PERIOD_S
        track.measured = np.array([range_m, -speed_mps * np.cos(bearing_rad), bearing_rad])
        track.state = track.measured.copy()
        way.update(round(frame * PERIOD_S * 1e9), [track], Motion(speed_mps))
        return way.level(track)

    ahead = [level_after(frame, 0.0) for frame in range(8)]
    beside = [level_after(frame, 0.7) for frame in range(8, 18)]
    assert ahead[-1] == "IMMINENT"
    assert beside[0] == "IMMINENT"  # one frame is no proof
    assert set(beside[-4:]) == {"SAFE"}


@pytest.mark.parametrize(
    ("ranges_m", "speed_mps"),
    [
        ([0.4] * 12, 0.0),
        (list(np.arange(1.6, 0.3, -0.012)), -0.12),
    ],  # appears and stands; creeps too slowly for the gate
)
def test_very_close_is_flagged_whatever_its_speed(ranges_m: list[float], speed_mps: float) -> None:
    pipeline = RadarPipeline(CONFIG)
    quiet = [bgt60.simulate(bgt60.LEAKAGE, SHAPE, seed=i) for i in range(20)]
    there = [
        bgt60.simulate([*bgt60.LEAKAGE, Target(r, speed_mps, amplitude_lsb=100.0)], SHAPE, seed=99 + i)
        for i, r in enumerate(ranges_m)
    ]
    reported = [pipeline.process(10**18 + i * 10**8, frame).level for i, frame in enumerate([*quiet, *there])]
    assert set(reported[: -len(there)]) == {"SAFE"}
    assert set(reported[-2:]) == {"CAUTION"}


def test_an_alarm_names_the_time_to_contact() -> None:
    steps = drive(box_ahead(2.0, 6.0), 5.5)
    for one in steps:
        for track in one.message.tracks:
            if track.on_way and track.level != "SAFE":
                assert track.ttc_s == pytest.approx((6.0 - one.x_m) / 2.02, abs=0.15)


def test_the_cover_is_of_all_that_stands_only_while_driving() -> None:
    steps = drive(box_ahead(2.0, 6.0), 4.6)
    before, during = steps[20].message.cover, steps[45].message.cover
    assert before is not None
    assert during is not None
    assert (before.standing, during.standing) == (False, True)
    assert during.far_m == [CONFIG.on_path.cover_far_m]
    assert steps[5].message.cover is not None
    assert steps[5].message.cover.far_m == [0.0]  # the background is not learned yet
    assert steps[5].message.cover.why


def followed(place_m: tuple[float, float], velocity_mps: tuple[float, float], seen: range, seed: int) -> list[Level]:
    """The levels of a body that moves, measured with noise in the frames ``seen`` and missed after them.

    ``place_m`` and ``velocity_mps`` over ground in the vehicle's frame of the first frame; we drive 2 m/s.
    """
    rng, way, reported, own_mps = np.random.default_rng([27, seed]), Way(CONFIG), [], 2.0
    track = Track(np.zeros(3), np.eye(3), snr_db=20.0, has_azimuth=True, approaching=True)
    for frame in seen:
        offset = np.array(place_m) - [CONFIG.mounting.x_m, 0.0]
        relative = np.array(velocity_mps) - [own_mps, 0.0]
        offset += relative * frame * PERIOD_S
        range_m, bearing_rad = float(np.hypot(*offset)), float(np.arctan2(offset[1], offset[0]))
        noise = rng.standard_normal(3) * [0.05, 0.03, 0.05]
        track.measured = np.array([range_m, relative @ offset / range_m, bearing_rad]) + noise
        track.state = track.measured.copy()
        way.update(round(frame * PERIOD_S * 1e9), [track], Motion(own_mps))
        assert track.meeting is not None
        track.meeting.standing._surges = 9  # its speed has shown that it moves
        reported.append(way.level(track))
    return reported


def test_who_walks_along_beside_the_way_wavers_and_does_not_alarm() -> None:
    for seed in range(6):
        assert set(followed((5.0, 1.0), (0.8, 0.0), range(36), seed)) == {"SAFE"}


def test_who_walks_into_the_way_is_imminent_in_time() -> None:
    """From the side, to be hit after 2.0 s."""
    for seed in range(12):
        reported = followed((4.2, -2.5), (0.0, 1.2), range(21), seed)
        assert reported.index("IMMINENT") <= 14


def test_an_echo_that_failed_to_come_puts_nothing_on_the_way() -> None:
    """An oncoming car slides past a cart; its echo jumps back along its side once, and is gone."""
    way, own_mps = Way(configs_of("cart").radar), 2.0
    track = Track(np.zeros(3), np.eye(3), snr_db=36.0, has_azimuth=True, approaching=True)
    echoes = [(3.14, -3.65, 0.42), (2.75, -3.55, 0.49), (2.345, -3.333, 0.595), None, (1.742, -2.605, 0.865)]
    reported = []
    for frame, echo in enumerate([*echoes, (1.494, -3.195, 0.669), None, None]):
        track.measured = None if echo is None else np.array(echo)
        track.state = track.state if echo is None else np.array(echo)
        way.update(round(frame * PERIOD_S * 1e9), [track], Motion(own_mps))
        assert track.meeting is not None
        track.meeting.standing._surges = 9
        reported.append(way.level(track))
    assert track.meeting.likely.contact_s is not None  # carried on as the last echo has it, it would come
    assert set(reported) == {"SAFE"}


def test_a_bearing_hardly_known_from_afar_is_no_place_in_the_way() -> None:
    """An oncoming car that a cart will pass with 0.6 m of air: in its first frames its place is known to 1 m."""
    way, own_mps, closing_mps, beside_m = Way(configs_of("cart").radar), 4.0, 6.0, 1.12
    track = Track(np.zeros(3), np.eye(3), snr_db=25.0, has_azimuth=True, approaching=True)
    for frame in range(6):
        x = 11.7 - frame * closing_mps * PERIOD_S
        range_m, bearing_rad = float(np.hypot(x, beside_m)), float(np.arctan2(beside_m, x))
        track.measured = track.state = np.array([range_m, -closing_mps * x / range_m, bearing_rad])
        way.update(round(frame * PERIOD_S * 1e9), [track], Motion(own_mps))
        assert track.meeting is not None
        assert not track.meeting.likely.on_way
