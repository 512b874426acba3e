"""How a claim begins, is renewed, counted out and lowered, message by message."""

from __future__ import annotations

from typing import Any

import pytest

from services.jetson.fusion.claims import (
    count_camera,
    level_of,
)
from services.jetson.fusion.evidence import Claim, Place, SensorInput, Sighting
from tests.jetson.fusion.claims_by_hand import CLEAR, GONE, HERE, after, claim, inputs, shows

# A sensor about its own claims


def test_a_sighting_makes_a_claim() -> None:
    first = Sighting("CAUTION", Place(2.0, 0.0, 0.1), "zone", "k")
    given = inputs(lidar=SensorInput("degraded", "CAUTION", sightings=(first,)))
    assert after(given) == (Claim("lidar", "CAUTION", 10.0, 10.0, Place(2.0, 0.0, 0.1), "zone", "k", lost=True),)
    assert not after(inputs(lidar=shows("CAUTION", HERE)))[0].lost


def test_the_worst_and_nearest_of_many_are_kept() -> None:
    places = [Place(20.0 - 1.5 * one, 0.0, 0.0) for one in range(12)] + [Place(0.2, 3.0 * one, 0.0) for one in range(8)]
    claims = after(inputs(lidar=shows("CAUTION", *places), radar=shows("IMMINENT", Place(30.0, 0.0, 0.0))))
    assert len([one for one in claims if one.by == "lidar"]) == 16
    assert max(one.place.x_m for one in claims if one.by == "lidar" and one.place) == 14.0
    levels = [Sighting("CAUTION", Place(1.0, 2.0 * one, 0.0)) for one in range(16)]
    claims = after(
        inputs(lidar=SensorInput("online", "IMMINENT", sightings=(*levels, Sighting("IMMINENT", Place(9, 0, 0)))))
    )
    assert (claims[0].level, len(claims)) == ("IMMINENT", 16)


def test_a_renewed_claim_keeps_its_beginning_and_takes_the_rest_from_the_sighting() -> None:
    old = claim(since_seen=(None, None), lost=True, counted=True, seen_by=("camera",), travelled_m=2.0, level="CAUTION")
    (kept,) = after(inputs(lidar=shows("IMMINENT", Place(1.2, 0.0, 0.1))), old)
    assert kept == Claim("lidar", "IMMINENT", 9.0, 10.0, Place(1.2, 0.0, 0.1), seen_by=("camera",), counted=True)
    (kept,) = after(inputs(lidar=shows("IMMINENT", None)), old)
    assert kept.place == HERE, "where it was, as long as nobody says better"


NOTHING: dict[str, tuple[SensorInput, int | None]] = {  # how many messages without it are noted; None = it is over
    "online": (CLEAR, 1),
    "degraded": (SensorInput("degraded", None), 0),
    "disconnected": (GONE, 0),
    "repeated": (SensorInput("online", "SAFE", stamp_ns=7), 0),
}


@pytest.mark.parametrize("case", NOTHING)
def test_only_a_new_message_of_a_sensor_that_can_see_counts(case: str) -> None:
    lidar, count = NOTHING[case]
    (kept,) = after(inputs(lidar=lidar), claim(), stamps_ns={"lidar": 7})
    assert len(kept.since_seen) == count
    assert kept.lost == (lidar.state != "online")
    assert kept.seen_s == 9.9


def test_the_last_message_needed_ends_it() -> None:
    for before in (0, 1):
        (kept,) = after(inputs(), claim(since_seen=(None,) * before))
        assert kept.since_seen == (None,) * (before + 1)
    assert after(inputs(), claim(since_seen=(None, None))) == ()


@pytest.mark.parametrize(
    ("lost", "place", "counted"), [(True, Place(1, 1, 0), 0), (False, Place(1, 1, 0), 1), (True, HERE, 1)]
)
def test_what_comes_back_is_asked_only_about_what_it_looks_at(lost: bool, place: Place, counted: int) -> None:
    """45 degrees to the side is outside the lidar's view: it may have moved there while nobody looked."""
    (kept,) = after(inputs(), claim(place, lost=lost))
    assert len(kept.since_seen) == counted


@pytest.mark.parametrize(
    ("since", "now", "level", "left"),
    [
        ((None, "CAUTION"), None, "CAUTION", (None,)),  # the worst of three; then one without it
        (("CAUTION", None), None, "CAUTION", (None, None)),
        (("CAUTION", "CAUTION"), None, "CAUTION", (None,)),
        ((None, None), "CAUTION", "CAUTION", ()),  # it shows the worst of them now
        (("CAUTION", "SAFE"), None, "CAUTION", ("SAFE", None)),
    ],
)
def test_it_is_lowered_to_the_worst_that_was_seen_since(since: Any, now: Any, level: Any, left: Any) -> None:
    lidar = CLEAR if now is None else shows(now, HERE)
    (kept,) = after(inputs(lidar=lidar), claim(since_seen=since))
    assert (kept.level, kept.since_seen, kept.seen_s, kept.lost) == (level, left, 10.0 if now else 9.9, False)


RAW: dict[str, tuple[Any, Any, Any, tuple[Any, ...]]] = {  # agreed, of this message alone; level and count after it
    "nothing at all": ("SAFE", "SAFE", "IMMINENT", ("CAUTION", None)),
    "as much, not agreed on": ("SAFE", "IMMINENT", "IMMINENT", ()),
    "less, not agreed on": ("SAFE", "CAUTION", "IMMINENT", ("CAUTION", "CAUTION")),
    "less is agreed on, as much is not": ("CAUTION", "IMMINENT", "IMMINENT", ()),
    "another that is agreed on": ("CAUTION", "CAUTION", "IMMINENT", ("CAUTION", None)),
}


@pytest.mark.parametrize("case", RAW)
def test_a_message_that_shows_it_before_its_sensor_agrees_is_no_message_without_it(case: str) -> None:
    """The LiDAR says a level after three scans; one scan alone that shows something does not say that it is free."""
    agreed, raw, level, since = RAW[case]
    elsewhere = () if agreed == "SAFE" else (Sighting(agreed, Place(9.0, 0.0, 0.0)),)
    lidar = SensorInput("online", agreed, sightings=elsewhere, raw_level=raw)
    kept = next(one for one in after(inputs(lidar=lidar), claim(since_seen=("CAUTION",))) if one.place == HERE)
    assert (kept.level, kept.since_seen, kept.seen_s) == (level, since, 9.9)


def test_three_scans_that_each_show_less_lower_it_to_that() -> None:
    lidar = SensorInput("online", "SAFE", raw_level="CAUTION")
    (kept,) = after(inputs(lidar=lidar), claim(since_seen=(None, None)))
    assert (kept.level, kept.since_seen) == ("CAUTION", ())


def test_as_bad_is_seen_less_is_counted() -> None:
    assert after(inputs(lidar=shows("CAUTION", HERE)), claim(level="CAUTION"))[0].seen_s == 10.0
    (kept,) = after(inputs(lidar=shows("CAUTION", HERE)), claim())
    assert (kept.level, kept.since_seen, kept.seen_s) == ("IMMINENT", ("CAUTION",), 9.9)


@pytest.mark.parametrize(("counted", "kept"), [(False, 0), (True, 1)])
@pytest.mark.parametrize("state", ["degraded", "disconnected"])
def test_only_a_word_of_the_camera_that_has_counted_outlives_it(counted: bool, kept: int, state: Any) -> None:
    claims = after(inputs(camera=SensorInput(state, None)), claim(by="camera", counted=counted))
    assert len(claims) == kept
    assert all(one.lost for one in claims)


def test_a_claim_of_a_sensor_that_is_not_even_configured_any_more_is_lost() -> None:
    (kept,) = after(inputs(), claim(by="sonar"))
    assert (kept.lost, kept.since_seen) == (True, ())


# Others about a lost sensor's claim


OTHERS: dict[str, tuple[dict[str, Any], dict[str, Any], int | None]] = {  # messages without it; None = it is there
    "one that had seen it": ({}, {}, 1),
    "one that had not": ({"seen_by": ()}, {}, 0),
    "it shows it": ({"since_seen": (None,)}, {"camera": shows("SAFE", HERE)}, 0),
    "it shows something somewhere": ({"since_seen": (None,)}, {"camera": shows("SAFE", None)}, 0),
    "it shows another": ({}, {"camera": shows("SAFE", Place(1.46, 0.0, 0.0))}, 1),
    "as near as two may disagree": ({}, {"camera": shows("SAFE", Place(1.44, 0.0, 0.0))}, 0),
    "its place is unknown": ({"place": None}, {"camera": shows("SAFE", Place(3.0, 0.0, 0.0))}, 0),
    "it is out": ({}, {"camera": SensorInput("degraded", None)}, 0),
    "it looks elsewhere": ({"place": Place(1.0, 1.0, 0.0)}, {}, 0),
    "its message was counted": ({}, {"camera": SensorInput("online", None, stamp_ns=5)}, 0),
    "it is no sensor of ours": ({"seen_by": ("sonar",)}, {}, 0),
}


@pytest.mark.parametrize("case", OTHERS)
def test_whose_word_about_a_lost_sensor_s_claim_counts(case: str) -> None:
    changed, sensors, count = OTHERS[case]
    lost = claim(**({"lost": True, "seen_by": ("camera",)} | changed))
    kept = [one for one in after(inputs(lidar=GONE, **sensors), lost, stamps_ns={"camera": 5}) if one.by == "lidar"]
    assert [len(one.since_seen) for one in kept] == [count]


def test_others_end_it_after_as_many_messages() -> None:
    lost = claim(lost=True, seen_by=("camera",), since_seen=(None, None))
    assert after(inputs(lidar=GONE), lost) == ()
    assert after(inputs(lidar=GONE, camera=GONE), lost) == (lost,)


def test_a_degraded_sensor_that_shows_it_now_is_believed_against_others() -> None:
    lost = claim(lost=True, seen_by=("camera",), since_seen=(None, None))
    (kept,) = after(inputs(lidar=shows("IMMINENT", HERE, state="degraded")), lost)
    assert (kept.seen_s, kept.since_seen) == (10.0, ())


def test_one_that_is_back_speaks_for_itself() -> None:
    """Its message was counted already; the camera's is new, and is not asked."""
    lost = claim(lost=True, seen_by=("camera",), since_seen=(None,))
    (kept,) = after(inputs(lidar=SensorInput("online", "SAFE", stamp_ns=7)), lost, stamps_ns={"lidar": 7})
    assert kept.since_seen == (None,)


# Who else sees it


SEEN: dict[str, tuple[dict[str, SensorInput], tuple[str, ...]]] = {
    "nobody": ({}, ()),
    "the camera": ({"camera": shows("SAFE", HERE)}, ("camera",)),
    "0.45 m off at 1 m": ({"camera": shows("SAFE", Place(1.44, 0.0, 0.0))}, ("camera",)),
    "farther": ({"camera": shows("SAFE", Place(1.46, 0.0, 0.0))}, ()),
    "the radar, which does not see what stands": ({"radar": shows("CAUTION", HERE)}, ()),
    "somewhere": ({"camera": shows("SAFE", None)}, ()),
    "two that could be it": ({"camera": shows("SAFE", HERE, Place(1.2, 0.0, 0.0))}, ()),
    "one of two": ({"camera": shows("SAFE", HERE, Place(3.0, 0.0, 0.0))}, ("camera",)),
    "it could be the lidar's other": (
        {"lidar": shows("IMMINENT", HERE, Place(1.0, 0.8, 0.0)), "camera": shows("SAFE", Place(1.0, 0.4, 0.0))}, (),
    ),
    "the lidar's other is elsewhere": (
        {"lidar": shows("IMMINENT", HERE, Place(1.0, 3.0, 0.0)), "camera": shows("SAFE", HERE)}, ("camera",),
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", SEEN)
def test_who_has_seen_it_and_only_it(case: str) -> None:
    sensors, names = SEEN[case]
    first, *_ = [one for one in after(inputs(**({"lidar": shows("IMMINENT", HERE)} | sensors))) if one.place == HERE]
    assert (first.by, first.seen_by) == ("lidar", names)


def test_exactly_as_far_apart_as_two_sensors_may_disagree_is_the_same() -> None:
    (kept, _) = after(inputs(lidar=shows("IMMINENT", Place(0.0, 0.0, 0.0)), camera=shows("SAFE", Place(0.3, 0.0, 0.0))))
    assert kept.seen_by == ("camera",)


def test_who_had_seen_it_stays_known_and_only_what_is_seen_now_is_compared() -> None:
    (kept, _) = after(inputs(lidar=shows("IMMINENT", HERE), camera=shows("SAFE", HERE)), claim(seen_by=("sonar",)))
    assert kept.seen_by == ("camera", "sonar")
    (kept, _) = after(inputs(lidar=GONE, camera=shows("SAFE", HERE)), claim())
    assert kept.seen_by == (), "the lidar does not see it now: it may be another"
    (kept, _) = after(inputs(lidar=shows("IMMINENT", None), camera=shows("SAFE", HERE)), claim(None))
    assert kept.seen_by == ()


# Time, a person, and the camera's word


DECAY: dict[str, tuple[float, dict[str, Any], dict[str, Any], str]] = {
    "in time": (19.99, {}, {}, "IMMINENT"),
    "over": (20.0, {}, {}, "CAUTION"),
    "driving": (30.0, {"moving": True}, {}, "IMMINENT"),
    "unknown": (30.0, {"moving": None}, {}, "IMMINENT"),
    "caution": (90.0, {}, {"level": "CAUTION"}, "CAUTION"),
    "looked at": (30.0, {"lidar": SensorInput("online", "SAFE", stamp_ns=7)}, {}, "IMMINENT"),
    "degraded": (30.0, {"lidar": SensorInput("degraded", None)}, {}, "CAUTION"),
    "of no sensor": (30.0, {}, {"by": "sonar"}, "CAUTION"),
}


@pytest.mark.parametrize("case", DECAY)
def test_standing_with_its_sensor_out_it_is_less_after_a_time(case: str) -> None:
    now_s, sensors, of_claim, level = DECAY[case]
    given = inputs(now_s, **({"moving": False, "lidar": GONE} | sensors))
    (kept,) = after(given, claim(seen_s=10.0, **of_claim), stamps_ns={"lidar": 7})
    assert kept.level == level


@pytest.mark.parametrize(("acknowledged", "count"), [(False, 2), (True, 1)])
def test_a_person_ends_what_is_not_seen_now(acknowledged: bool, count: int) -> None:
    given = inputs(lidar=GONE, radar=shows("CAUTION", HERE), acknowledged=acknowledged)
    claims = after(given, claim())
    assert (len(claims), claims[-1].by) == (count, "radar")


@pytest.mark.parametrize(
    ("by", "level", "counted"),
    [
        ("camera", "SAFE", False),
        ("camera", "CAUTION", True),
        ("camera", "IMMINENT", True),
        ("lidar", "IMMINENT", False),
    ],
)
def test_the_camera_s_word_is_noted_from_a_level_on(by: str, level: Any, counted: bool) -> None:
    (updated,) = count_camera((claim(by=by, level=level, seen_by=("sonar",)),), ("lidar",), "CAUTION")
    assert (updated.counted, updated.seen_by) == (counted, ("lidar", "sonar") if counted else ("sonar",))


def test_the_worst_of_them() -> None:
    assert level_of([]) is None
    assert level_of([claim(level="SAFE")]) == "SAFE"
    assert level_of([claim(level="CAUTION"), claim(), claim(level="SAFE")]) == "IMMINENT"
    assert after(inputs()) == ()
