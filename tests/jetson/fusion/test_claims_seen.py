"""What a message shows, of which claim, and where that is by now: numbers on both sides of every limit."""

from __future__ import annotations

from typing import Any

import pytest

from services.jetson.fusion.claims import (
    carry,
    fresh_sensors,
    is_ahead,
    match,
    sightings_of,
    somewhere_at,
    uses_static,
)
from services.jetson.fusion.evidence import FusionMemory, Place, SensorInput, Sighting
from tests.jetson.fusion.claims_by_hand import AT_2, HERE, RULES, claim, inputs, shows

# What a message shows


SIGHTINGS: dict[str, tuple[str, SensorInput, list[tuple[Any, Any, str]]]] = {
    "disconnected": ("lidar", shows("IMMINENT", HERE, state="disconnected"), []),
    "degraded": ("lidar", shows("IMMINENT", HERE, state="degraded"), [("IMMINENT", HERE, "")]),
    "camera degraded": ("camera", shows("IMMINENT", HERE, state="degraded"), []),
    "safe": ("lidar", shows("SAFE", HERE), []),
    "caution": ("lidar", shows("CAUTION", HERE), [("CAUTION", HERE, "")]),
    "camera safe": ("camera", shows("SAFE", HERE), [("SAFE", HERE, "")]),
    "camera level alone": ("camera", SensorInput("online", "SAFE", nearest_m=2.0), [("SAFE", AT_2, "message")]),
    "level alone": ("lidar", SensorInput("online", "CAUTION", nearest_m=2.0), [("CAUTION", AT_2, "message")]),
    "level without distance": ("lidar", SensorInput("online", "CAUTION"), [("CAUTION", None, "message")]),
    "level above its objects": (
        "lidar",
        SensorInput("online", "IMMINENT", sightings=(Sighting("CAUTION", HERE),)),
        [("CAUTION", HERE, ""), ("IMMINENT", None, "message")],
    ),
    "level below its objects": (
        "lidar",
        SensorInput("online", "CAUTION", sightings=(Sighting("IMMINENT", HERE),)),
        [("IMMINENT", HERE, "")],
    ),
    "one of two at its level": (
        "lidar",
        SensorInput("online", "IMMINENT", sightings=(Sighting("CAUTION", HERE), Sighting("IMMINENT", HERE))),
        [("CAUTION", HERE, ""), ("IMMINENT", HERE, "")],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", SIGHTINGS)
def test_what_a_message_shows(case: str) -> None:
    name, sensor, expected = SIGHTINGS[case]
    sightings = sightings_of(inputs(**{name: sensor}), name)
    assert [(one.level, one.place, one.key) for one in sightings] == expected


@pytest.mark.parametrize(
    ("lidar", "radar", "moving", "counts"),
    [
        ("degraded", "online", True, True),
        ("degraded", "online", None, True),
        ("degraded", "online", False, False),
        ("online", "online", None, False),
        ("disconnected", "online", None, False),
        ("degraded", "degraded", None, False),
        ("degraded", "disconnected", None, False),
    ],
)
@pytest.mark.parametrize("standing", ["CAUTION", "IMMINENT", "SAFE", None])
def test_when_standing_tracks_count(lidar: Any, radar: Any, moving: Any, counts: bool, standing: Any) -> None:
    tracks = SensorInput(radar, "SAFE", static_level=standing)
    given = inputs(moving=moving, lidar=SensorInput(lidar, None), radar=tracks)
    assert uses_static(given) == counts
    sightings = sightings_of(given, "radar")
    expected = [(standing, "standing", "standing")] if counts and standing in ("CAUTION", "IMMINENT") else []
    assert [(one.level, one.key, one.what) for one in sightings] == expected
    assert sightings_of(given, "lidar") == ()


def test_somewhere_ahead() -> None:
    assert somewhere_at(None) is None
    assert somewhere_at(1.2) == Place(1.2, 0.0, 0.3)


@pytest.mark.parametrize(
    ("stamp_ns", "counted_ns", "fresh"), [(0, 0, True), (0, None, True), (5, 5, False), (5, 4, True), (1, 1, False)]
)
def test_a_message_is_counted_once(stamp_ns: int, counted_ns: int | None, fresh: bool) -> None:
    memory = FusionMemory(stamps_ns={} if counted_ns is None else {"lidar": counted_ns})
    sensors = fresh_sensors(inputs(lidar=SensorInput("online", "SAFE", stamp_ns=stamp_ns)), memory)
    assert ("lidar" in sensors) == fresh


# Which sighting shows which claim


@pytest.mark.parametrize(
    ("where", "sighting", "same"),
    [
        (HERE, Place(1.0, 0.74, 0.0), True),  # 0.5 m and a quarter of the 1 m
        (HERE, Place(1.0, 0.76, 0.0), False),
        (HERE, Place(1.75, 0.0, 0.0), True),
        (Place(2.0, 0.0, 0.1), Place(2.0, 1.29, 0.2), True),  # between the edges: 0.5 m and half a metre
        (Place(2.0, 0.0, 0.1), Place(2.0, 1.31, 0.2), False),
        (None, HERE, True),
        (HERE, None, True),
        (None, None, True),
    ],
)
def test_an_object_moves_only_so_far_between_messages(where: Any, sighting: Any, same: bool) -> None:
    one = Sighting("CAUTION", sighting)
    assert match([claim(where)], (one,)) == ({0: one} if same else {})


def test_keys_tell_objects_apart_and_outdo_places() -> None:
    own, other, bare = (
        Sighting("CAUTION", Place(9, 9, 0), key="a"),
        Sighting("CAUTION", HERE, key="b"),
        Sighting("CAUTION", HERE),
    )
    assert match([claim(key="a")], (other, bare, own)) == {0: own}
    assert match([claim(key="a")], (other, bare)) == {}
    assert match([claim()], (other,)) == {}


def test_each_sighting_shows_one_claim_the_nearest_first_and_an_unknown_place_last() -> None:
    near, far = Sighting("CAUTION", Place(1.1, 0.0, 0.0)), Sighting("CAUTION", Place(1.4, 0.0, 0.0))
    claims = [claim(Place(1.4, 0.0, 0.0)), claim(Place(1.0, 0.0, 0.0)), claim(None)]
    assert match(claims, (near, far)) == {0: far, 1: near}
    assert match([claim(None), claim(HERE)], (near,)) == {1: near}
    assert match([claim(None), claim(HERE)], (near, Sighting("CAUTION", None))) == {
        0: Sighting("CAUTION", None),
        1: near,
    }
    assert match([claim(HERE)], (Sighting("CAUTION", None), far)) == {0: far}


# What our own motion does to a place


@pytest.mark.parametrize(
    ("at_s", "now_s", "way_m"),
    [(10.0, 10.5, 0.5), (10.0, 11.0, 1.0), (10.0, 13.0, 1.0), (10.0, 9.0, 0.0), (None, 9.0, 0.0)],
)
def test_a_long_gap_is_not_driven_blindly(at_s: float | None, now_s: float, way_m: float) -> None:
    given = inputs(now_s, moving=True, speed_mps=1.0, yaw_rate_radps=0.0)
    (moved,) = carry(given, FusionMemory(at_s, (claim(Place(5.0, 0.0, 0.0)),)), RULES)
    assert moved.place == Place(5.0 - way_m, 0.0, 0.0)
    assert moved.travelled_m == way_m


@pytest.mark.parametrize(
    "unknown",
    [
        {"moving": None, "speed_mps": 1.0, "yaw_rate_radps": 0.0},
        {"moving": False, "speed_mps": 1.0, "yaw_rate_radps": 0.0},
        {"moving": True, "speed_mps": None, "yaw_rate_radps": 0.0},
        {"moving": True, "speed_mps": 1.0, "yaw_rate_radps": None},
    ],
)
def test_unknown_motion_moves_nothing(unknown: dict[str, Any]) -> None:
    (kept,) = carry(inputs(10.5, **unknown), FusionMemory(10.0, (claim(),)), RULES)
    assert kept == claim()


def test_driving_back_is_a_way_as_well_and_turning_turns() -> None:
    given = inputs(10.5, moving=True, speed_mps=-1.0, yaw_rate_radps=0.2)
    (moved, unknown) = carry(given, FusionMemory(10.0, (claim(travelled_m=0.25), claim(None))), RULES)
    assert moved.place == pytest.approx((1.5 * 0.995, -1.5 * 0.0998, 0.0), abs=1e-3)
    assert moved.travelled_m == 0.75
    assert unknown == claim(None)


@pytest.mark.parametrize(
    ("place", "kept"),
    [
        (Place(14.0, 1.9, 0.0), True),
        (Place(14.0, -2.1, 0.0), True),
        (Place(14.5, 1.9, 0.0), True),  # 14 + 1.9 m off now, less the 1 m of way
        (Place(14.5, -2.1, 0.0), False),
        (Place(16.5, 0.0, 0.0), True),  # exactly
        (Place(-0.1, 0.6, 0.0), True),
        (Place(-0.7, 0.6, 0.0), False),  # behind, by the length and the motion's error
    ],
)
def test_what_is_far_or_behind_is_left(place: Place, kept: bool) -> None:
    given = inputs(10.5, moving=True, speed_mps=1.0, yaw_rate_radps=0.0)
    carried = list(carry(given, FusionMemory(10.0, (claim(place, travelled_m=0.5), claim())), RULES))
    assert len(carried) == (2 if kept else 1)


@pytest.mark.parametrize(
    ("place", "travelled_m", "ahead"),
    [
        (None, 1.0, True),
        (HERE, 1.0, True),
        (Place(1.0, 0.9, 0.0), 0.0, True),  # seen there: it counts wherever it is
        (Place(1.0, 0.9, 0.0), 1.0, False),
        (Place(1.0, 0.9, 0.0), 1.5, True),
    ],
)
def test_a_place_beside_the_way_sleeps(place: Place | None, travelled_m: float, ahead: bool) -> None:
    assert is_ahead(claim(place, travelled_m=travelled_m), RULES) == ahead
