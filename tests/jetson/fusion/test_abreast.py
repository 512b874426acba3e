"""Two things abreast are one echo to the radar: when the lidar's word counts against it, and when it does not."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

from common.messages import Cover, LaneLayout, LidarZone, LidarZones, Motion, RadarTrack, RadarTracks
from common.path import PathConfig
from services.jetson.fusion.abreast import AbreastWatch, Dated
from services.jetson.fusion.config import RulesConfig
from services.jetson.fusion.evidence import Abreast, FusionInputs, FusionMemory, Place, SensorInput, Sighting
from services.jetson.fusion.verdict import fuse

PATH = PathConfig()
DRIVING = Motion(2.0)
LIDAR_X_M, RADAR_X_M = 0.1, 0.2
FAR_M, SECTORS = 8.0, 90
GATE = ((3.2, 0.45), (3.2, -0.45))  # two posts, vehicle's frame; 3.03 m from the radar


def lidar(*things: tuple[float, float], reach_m: float = FAR_M) -> LidarZones:
    """What the lidar covers when these points, and nothing else, stand around the vehicle."""
    far_m = [reach_m] * SECTORS
    for x, y in things:
        bearing = math.atan2(y, x - LIDAR_X_M)
        far_m[int((bearing + math.pi / 2) / math.pi * SECTORS)] = math.hypot(x - LIDAR_X_M, y)
    cover = Cover(x_m=LIDAR_X_M, y_m=0.0, first_rad=-math.pi / 2, step_rad=math.pi / SECTORS, far_m=far_m)
    free = LidarZone(nearest_m=None, points=0, level="SAFE")
    return LidarZones(
        stamp_ns=10**18, left=free, centre=free, right=free, level="SAFE", raw_level="SAFE", scan_hz=10.0, cover=cover
    )


def track(level: str = "IMMINENT", range_m: float = 3.0, **fields: Any) -> RadarTrack:
    """Standing, straight ahead by its azimuth, up to 1 m beside by its speed."""
    values: dict[str, Any] = {"track_id": 1, "azimuth_rad": 0.0, "beside_m": (0.0, 1.0), **fields}
    return RadarTrack(
        range_m=range_m, velocity_mps=-2.0, age_frames=9, approaching=True, moving=False, ttc_s=1.4,
        level=level, snr_db=20.0, **values,
    )  # fmt: skip


def radar(*tracks: RadarTrack, stamp_ns: int = 10**18) -> RadarTracks:
    cover = Cover(x_m=RADAR_X_M, y_m=0.0, first_rad=-0.8, step_rad=1.6, far_m=[6.0])
    return RadarTracks(
        stamp_ns=stamp_ns, tracks=list(tracks), level="IMMINENT", settled=True, noise_floor_db=10.0, cover=cover
    )


def left_over(tracks: RadarTracks, seen: LidarZones, motion: Motion | None = DRIVING) -> Abreast | None:
    return AbreastWatch(PATH).set_aside(Dated(tracks, 0.05, seen, 0.05), motion)


def test_two_posts_that_the_lidar_sees_are_no_alarm() -> None:
    assert left_over(radar(track()), lidar(*GATE)) == Abreast("SAFE", (), "IMMINENT", 3.0)


def test_what_comes_nearer_far_too_slowly_to_be_ahead_is_no_alarm() -> None:
    """By its speed at least half of its distance beside: nothing has to be seen there. Nearer to the way it has."""
    far, less = track(beside_m=(1.5, 1.8)), track(beside_m=(1.49, 1.8))
    assert left_over(radar(far), lidar()) == Abreast("SAFE", (), "IMMINENT", 3.0)
    assert left_over(radar(less), lidar()) is None
    assert left_over(radar(far), lidar((2.0, 0.02))) is None  # something stands in the way
    assert left_over(radar(far), lidar(), Motion(2.0, 0.04)) is None  # in a curve the way leads there


@pytest.mark.parametrize(
    ("level", "said", "caution_m", "aside"),
    [
        ("CAUTION", "SAFE", 5.0, True),
        ("IMMINENT", "SAFE", 5.0, False),  # what a stop needs never waits
        ("CAUTION", "CAUTION", 5.0, False),  # the lidar does not wait either
        ("CAUTION", "SAFE", 2.5, False),  # it is beyond where the lidar's CAUTION begins
    ],
)
def test_a_caution_waits_with_the_lidars_own(level: str, said: str, caution_m: float, aside: bool) -> None:
    """The outer wall of a bend, 2.9 m from the radar; the lidar knows that it leads off."""
    layout = LaneLayout(centre_width_m=0.3, side_width_m=0.1, look_ahead_m=6.0, imminent_m=1.8, caution_m=caution_m)
    seen = msgspec.structs.replace(lidar((3.2, 0.02)), level=said, layout=layout)
    assert (left_over(radar(track(level)), seen) is not None) == aside


COUNTS = {
    "nothing beside the way": (track(), lidar(), DRIVING),
    "one post alone": (track(), lidar(GATE[0]), DRIVING),
    "two posts on one side": (track(), lidar(GATE[0], (3.15, 0.7)), DRIVING),
    "posts nearer than the echo": (track(), lidar((2.5, 0.45), (2.5, -0.45)), DRIVING),
    "posts farther than the echo": (track(), lidar((4.2, 0.45), (4.2, -0.45)), DRIVING),
    "the speed shows it nearer to the way than the posts": (track(beside_m=(0.0, 0.3)), lidar(*GATE), DRIVING),
    "the speed shows it farther off": (track(beside_m=(0.7, 1.0)), lidar(*GATE), DRIVING),
    "it moves, or its speed is not known": (track(beside_m=None), lidar(*GATE), DRIVING),
    "something in the way before it": (track(), lidar(*GATE, (2.0, 0.02)), DRIVING),
    "something in the way between the posts": (track(), lidar(*GATE, (3.2, 0.02)), DRIVING),
    "a caution about what the lidar sees in the way": (track("CAUTION", range_m=6.0), lidar((6.2, 0.0)), DRIVING),
    "the vehicle stands": (track(), lidar(*GATE), Motion(0.0)),
    "the motion is unknown": (track(), lidar(*GATE), None),
    "the lidar does not say what it covers": (
        track(),
        msgspec.structs.replace(lidar(*GATE), cover=None),
        DRIVING,
    ),
}


@pytest.mark.parametrize("case", COUNTS.values(), ids=COUNTS)
def test_the_radar_counts_when(case: tuple[RadarTrack, LidarZones, Motion | None]) -> None:
    one, seen, motion = case
    assert left_over(radar(one), seen, motion) is None


def test_only_the_track_between_the_posts_is_set_aside() -> None:
    there = track("CAUTION", range_m=5.0, track_id=2)
    rest = left_over(radar(track(), there), lidar(*GATE))
    assert rest is not None
    assert (rest.level, rest.aside_level) == ("CAUTION", "IMMINENT")
    assert [one.place and one.place.x_m for one in rest.sightings] == [5.0]


def test_each_place_is_carried_to_the_time_of_the_other() -> None:
    """The lidar's scan is 0.3 s older than the radar's frame: the posts have come 0.6 m nearer since."""
    seen = lidar((3.8, 0.45), (3.8, -0.45))
    assert AbreastWatch(PATH).set_aside(Dated(radar(track()), 0.05, seen, 0.35), DRIVING) is not None
    assert AbreastWatch(PATH).set_aside(Dated(radar(track(range_m=2.6)), 0.05, seen, 0.05), DRIVING) is None


def test_a_scan_that_misses_a_post_ends_it_after_half_a_second() -> None:
    watch = AbreastWatch(PATH)
    assert watch.set_aside(Dated(radar(track()), 0.05, lidar(*GATE), 0.05), DRIVING) is not None
    for after_ms, counts in ((100, False), (500, False), (520, True)):
        tracks = radar(track(), stamp_ns=10**18 + after_ms * 10**6)
        assert (watch.set_aside(Dated(tracks, 0.05, lidar(), 0.05), DRIVING) is None) == counts


def test_what_was_beside_before_the_radars_clock_went_back_counts_again() -> None:
    """Set back by an hour or restarted with a clock that is behind: another thing has the number of the first one."""
    watch = AbreastWatch(PATH)
    assert watch.set_aside(Dated(radar(track()), 0.05, lidar(*GATE), 0.05), DRIVING) is not None
    tracks = radar(track(), stamp_ns=10**18 - 3600 * 10**9)
    assert watch.set_aside(Dated(tracks, 0.05, lidar(), 0.05), DRIVING) is None


def test_a_caution_beyond_the_lidars_reach_waits_only_while_a_stop_needs_less() -> None:
    beyond = track("CAUTION", range_m=9.0)
    assert left_over(radar(beyond), lidar()) == Abreast("SAFE", (), "CAUTION", 9.0)
    assert left_over(radar(track("IMMINENT", range_m=9.0)), lidar()) is None
    assert left_over(radar(beyond), lidar(), Motion(5.0)) is None  # to stop takes 6.8 m, and 0.75 s are 3.7 m more


POST_RAD, POST_M = math.radians(9.0), 3.1  # the middle of a sector on either side, from the lidar
POST = (LIDAR_X_M + POST_M * math.cos(POST_RAD), POST_M * math.sin(POST_RAD))
FROM_RADAR_M, ASIDE_M = math.hypot(POST[0] - RADAR_X_M, POST[1]), POST[1]


@pytest.mark.parametrize(
    ("range_m", "beside_m", "aside"),
    [
        (FROM_RADAR_M + 0.399, (0.0, 1.0), True),  # the echo's range is that of a body's nearest part
        (FROM_RADAR_M + 0.401, (0.0, 1.0), False),
        (FROM_RADAR_M - 0.699, (0.0, 1.0), True),
        (FROM_RADAR_M - 0.701, (0.0, 1.0), False),
        (FROM_RADAR_M, (ASIDE_M + 0.099, 1.0), True),
        (FROM_RADAR_M, (ASIDE_M + 0.101, 1.0), False),
        (FROM_RADAR_M, (0.0, ASIDE_M - 0.099), True),
        (FROM_RADAR_M, (0.0, ASIDE_M - 0.101), False),
    ],
)
def test_how_far_off_the_echo_the_posts_may_be(range_m: float, beside_m: tuple[float, float], aside: bool) -> None:
    tracks = radar(track(range_m=range_m, beside_m=beside_m))
    assert (left_over(tracks, lidar(POST, (POST[0], -POST[1]))) is not None) == aside


def in_sector(sector: int, aside_m: float) -> tuple[float, float]:
    """Where the ray in the middle of a sector ends on a line beside the way."""
    bearing = -math.pi / 2 + (sector + 0.5) * math.pi / SECTORS
    return LIDAR_X_M + aside_m / math.tan(bearing), aside_m


RIGHT_ROW = tuple(in_sector(SECTORS - 1 - sector, -1.0) for sector in (52, 51, 50, 49, 48))


@pytest.mark.parametrize(
    ("range_m", "near", "far", "aside"),
    [
        (4.3, (52, 1.0), (50, 1.0), True),  # one sector between the two rays, 3.8 and 5.1 m away
        (4.3, (53, 1.0), (50, 1.0), False),  # two
        (7.0, (49, 1.0), (48, 1.02), True),  # 1.99 m apart
        (7.0, (49, 1.0), (48, 1.026), False),  # 2.02 m
        (4.1, (52, 0.9), (51, 1.19), True),  # by 0.29 m not in line
        (4.1, (52, 0.9), (51, 1.21), False),  # by 0.31 m
        (4.3, (52, 1.0), (90 - 1 - 50, -1.0), False),  # the far one is the right's
        (4.3, (52, 1.0), (52, 1.0), False),  # nothing farther
    ],
)
def test_an_echo_may_come_from_between_the_rays_of_a_row(
    range_m: float, near: tuple[int, float], far: tuple[int, float], aside: bool
) -> None:
    tracks = radar(track(range_m=range_m, beside_m=(0.6, 0.98)))
    seen = lidar(*RIGHT_ROW, in_sector(*near), in_sector(*far), reach_m=12.0)
    assert (left_over(tracks, seen) is not None) == aside


@pytest.mark.parametrize(("least_m", "aside"), [(1.96, True), (1.94, False)])
def test_far_beside_is_measured_from_the_way_which_may_curve(least_m: float, aside: bool) -> None:
    """Half of its 3 m; an arc of 10 m leads off the line of travel by 0.45 m there."""
    tracks = radar(track(range_m=3.0, beside_m=(least_m, 3.0)))
    assert (left_over(tracks, lidar(), Motion(2.0, 0.2)) is not None) == aside


def test_in_a_curve_the_sides_are_those_of_the_line_of_travel() -> None:
    """In a left turn the radar, ahead of the axle, drifts to the left: at 3 m by 9 cm. One post is 5 cm left of x."""
    posts, tracks = lidar((3.2, 0.05), (3.1, 1.25)), radar(track(beside_m=(0.0, 1.2)))
    assert left_over(tracks, posts, Motion(2.0, 0.3)) is not None
    assert left_over(tracks, posts, Motion(2.0, 0.0)) is None


def test_a_sector_that_was_not_seen_is_no_post() -> None:
    """The lidar is mounted on the right and is covered there; one post stands on the left."""
    seen = lidar((0.45, 0.3))
    assert seen.cover is not None
    covered = msgspec.structs.replace(seen.cover, y_m=-0.12, far_m=[0.0] * 30 + seen.cover.far_m[30:])
    tracks = radar(track(range_m=0.45))
    assert left_over(tracks, msgspec.structs.replace(seen, cover=covered)) is None


def test_of_two_that_are_set_aside_the_worse_is_named() -> None:
    tracks = radar(track("CAUTION", range_m=2.8, track_id=2), track(range_m=2.987))
    assert left_over(tracks, lidar(*GATE)) == Abreast("SAFE", (), "IMMINENT", 2.99)


@pytest.mark.parametrize(("reach_m", "waits"), [(5.3, False), (5.5, True)])
def test_it_waits_while_the_way_is_free_for_a_while_longer_than_a_stop(reach_m: float, waits: bool) -> None:
    """At 3 m/s a stop takes 3.1 m, and 0.75 s are 2.25 m."""
    rest = left_over(radar(track("CAUTION", range_m=9.0)), lidar(reach_m=reach_m), Motion(3.0))
    assert (rest is not None) == waits


def decided(abreast: Abreast | None) -> Any:
    seen = SensorInput("online", "SAFE", 0.05)
    alarm = SensorInput(
        "online", "IMMINENT", 0.05, nearest_m=3.0, sightings=(Sighting("IMMINENT", Place(3.0, 0.0, 0.2)),)
    )
    inputs = FusionInputs(10.0, True, seen, alarm, SensorInput("online", None, 0.05))
    return fuse(replace(inputs, abreast=abreast), FusionMemory(), RulesConfig())[0]


def test_the_verdict_says_what_was_set_aside() -> None:
    assert decided(None).level == "IMMINENT"
    verdict = decided(Abreast("SAFE", (), "IMMINENT", 3.0))
    assert (verdict.level, verdict.rule) == ("SAFE", "R10-abreast")
    assert "IMMINENT at 3.00 m" in verdict.because
    assert "beside it" in verdict.because
    assert not verdict.inputs["radar"].used


def test_what_is_left_still_counts() -> None:
    rest = Abreast("CAUTION", (Sighting("CAUTION", Place(5.0, 0.0, 0.2)),), "IMMINENT", 3.0)
    assert (decided(rest).level, decided(rest).rule) == ("CAUTION", "R1-worst-case")
    assert np.isfinite(decided(rest).claims[0].x_m)
