"""Collective Perception Messages bit by bit, against a plain writer of the standard's tables, and back to tracks."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("asn1tools", reason="needs the cpm extra")

from common.geodesy import MapOrigin
from common.messages import ObjectTrack, ObjectTracks
from spotter_tools.cli.cpm import why_not
from spotter_tools.cpm.codec import CpmError, decode, encode
from spotter_tools.cpm.message import MAX_OBJECTS, its_time_ms, messages_of

STAMP_NS = 1_790_000_000_123_000_000
ORIGIN = MapOrigin(latitude_deg=52.5163, longitude_deg=-13.3777, altitude_m=41.5, heading_deg=90.0)


def track(track_id: int = 7, **changed: Any) -> ObjectTrack:
    about: dict[str, Any] = {
        "track_id": track_id, "label": "car", "label_confidence": 0.9, "position_m": (12.34, -5.6, 0.75),
        "velocity_mps": (3.0, -4.0, 0.0), "covariance": [[0.04 * (i == j) for j in range(6)] for i in range(6)],
        "size_m": (4.2, 1.8, 1.5), "yaw_rad": math.radians(30.0), "age_s": 1.5, "score": 0.8, "state": "confirmed",
        "points": 120,
    }  # fmt: skip
    return ObjectTrack(**about | changed)


def tracks(*found: ObjectTrack, **more: Any) -> ObjectTracks:
    return ObjectTracks(stamp_ns=STAMP_NS, tracks=list(found), frame_id="map", source_kind="live", **more)


# --- a writer of bits that knows nothing of ASN.1: each call is a line of the standard's tables ---


class Bits:
    """UPER, X.691, slow and plain."""

    def __init__(self) -> None:
        self.text = ""

    def integer(self, value: int, low: int, high: int) -> None:
        """A whole number in a range (clause 11.5)."""
        width = (high - low).bit_length()
        self.text += format(value - low, f"0{width}b") if width else ""

    def flags(self, text: str) -> None:
        """Extension bits and what is present of the optional parts, in their order."""
        self.text += text.replace(" ", "")

    def octets(self) -> bytes:
        """Padded to whole octets; one octet at least (clause 11.1)."""
        text = self.text or "0"
        text += "0" * (-len(text) % 8)
        return int(text, 2).to_bytes(len(text) // 8, "big")

    def open_type(self, data: bytes) -> None:
        """Length, one octet below 128 and two below 16384 (clause 11.9.3), and the octets."""
        self.text += format(len(data), "08b") if len(data) < 128 else "10" + format(len(data), "014b")
        self.text += "".join(format(byte, "08b") for byte in data)


def perceived_object(bits: Bits) -> None:
    """The car of ``track``, with the map's x axis to the east."""
    bits.flags("0 1 1 0 1 0 0 1 1 1 1 1 1 1 0")  # extension; id, velocity, ., angles, ., ., Z, Y, X, age, quality, ...
    bits.integer(7, 0, 65535)
    bits.integer(0, -2048, 2047)
    bits.flags("1")  # zCoordinate
    for value in (1234, -560, 75):
        bits.integer(value, -131072, 131071)
        bits.integer(40, 1, 4096)  # 1.96 x 0.2 m = 0.392 m
    bits.integer(1, 0, 1)  # cartesianVelocity
    bits.flags("0")
    for value in (300, -400):
        bits.integer(value, -16383, 16383)
        bits.integer(40, 1, 127)
    bits.flags("00")
    bits.integer(300, 0, 3601)
    bits.integer(127, 1, 127)
    for value in (15, 18, 42):
        bits.integer(value, 1, 256)
        bits.integer(32, 1, 32)
    bits.integer(1500, 0, 2047)
    bits.integer(12, 0, 15)
    bits.flags("0")  # sensorIdList within 1..128
    bits.integer(1, 1, 128)
    bits.integer(1, 0, 255)
    bits.integer(1, 1, 8)  # classification
    bits.flags("0")
    bits.integer(0, 0, 3)  # vehicleSubClass
    bits.integer(5, 0, 14)
    bits.integer(90, 1, 101)


def whole_message() -> bytes:
    rsu, sensors, objects, bits = Bits(), Bits(), Bits(), Bits()
    rsu.flags("0 0")
    sensors.flags("0")
    sensors.integer(1, 1, 128)
    sensors.flags("0 0 0")
    sensors.integer(1, 0, 255)
    sensors.integer(2, 0, 31)
    sensors.flags("1")
    objects.flags("0")
    objects.integer(1, 0, 255)
    objects.flags("0")
    objects.integer(1, 0, 255)
    perceived_object(objects)
    for value, high in ((2, 255), (14, 255), (4711, 4294967295)):
        bits.integer(value, 0, high)
    bits.flags("0 0 0 0")  # extension of the payload; of the management container, its two optional parts
    bits.integer(717_084_805_123, 0, 4398046511103)
    bits.integer(525_163_000, -900000000, 900000001)
    bits.integer(-133_777_000, -1800000000, 1800000001)
    for value, high in ((4095, 4095), (4095, 4095), (3601, 3601)):
        bits.integer(value, 0, high)
    bits.integer(4150, -100000, 800001)
    bits.integer(15, 0, 15)
    bits.integer(3, 1, 8)
    for number, one in ((2, rsu), (3, sensors), (5, objects)):
        bits.integer(number, 1, 16)
        bits.open_type(one.octets())
    return bits.octets()


def test_every_bit_is_where_the_standard_has_it() -> None:
    (content,) = messages_of(tracks(track()), ORIGIN, 4711)
    assert encode(content).hex() == whole_message().hex()


def test_the_message_of_this_release_stays_the_same() -> None:
    """So that a change of a library, or of ours, is seen: the bytes of the car."""
    (content,) = messages_of(tracks(track()), ORIGIN, 4711)
    assert encode(content).hex() == GOLDEN


GOLDEN = (
    "020e00001267029bd657200ea79217c31a845cc7ffffff088cb6b7a101002040000228042700805a7f0003c00604d202"
    "77f74009e004b027a095a77cde9c12cfc1df11f94feee6000080b640"
)


@pytest.mark.parametrize(
    ("utc", "its_ms"),
    [
        (datetime(2004, 1, 1, tzinfo=UTC), 0),
        (datetime(2007, 1, 1, tzinfo=UTC), 94_694_401_000),  # the example of TS 102 894-2, TimestampIts
        (datetime(2026, 9, 21, 14, 13, 20, tzinfo=UTC), 717_084_805_000),
    ],
)
def test_time_counts_leap_seconds(utc: datetime, its_ms: int) -> None:
    assert its_time_ms(round(utc.timestamp()) * 1_000_000_000) == its_ms


@pytest.mark.parametrize(
    ("label", "expected"),
    [
        ("car", ("vehicleSubClass", 5)),
        ("large_vehicle", ("vehicleSubClass", 0)),
        ("pedestrian", ("vruSubClass", ("pedestrian", "unavailable"))),
        ("cyclist", ("vruSubClass", ("bicyclistAndLightVruVehicle", "bicyclist"))),
        ("unknown", ("otherSubClass", 0)),
        ("background", ("otherSubClass", 0)),
    ],
)
def test_classes(label: str, expected: object) -> None:
    (content,) = messages_of(tracks(track(label=label)), ORIGIN, 1)
    (seen,) = decode(encode(content))["containers"][5]["perceivedObjects"]
    assert seen["classification"] == [{"objectClass": expected, "confidence": 90}]


def test_the_map_is_turned_to_east_and_north() -> None:
    """With its x axis to the north, the map's x is north and its y west; so are speeds and their errors."""
    north = MapOrigin(latitude_deg=52.0, longitude_deg=13.0, heading_deg=0.0)
    covariance = np.diag([0.04, 0.09, 0.01, 0.16, 0.25, 0.01]).tolist()
    (content,) = messages_of(tracks(track(covariance=covariance)), north, 1)
    (seen,) = decode(encode(content))["containers"][5]["perceivedObjects"]
    assert (seen["position"]["xCoordinate"]["value"], seen["position"]["yCoordinate"]["value"]) == (560, 1234)
    assert seen["position"]["xCoordinate"]["confidence"] == math.ceil(196 * 0.3)
    assert seen["position"]["yCoordinate"]["confidence"] == math.ceil(196 * 0.2)
    _, velocity = seen["velocity"]
    assert (velocity["xVelocity"], velocity["yVelocity"]) == (
        {"value": 400, "confidence": math.ceil(196 * 0.5)}, {"value": 300, "confidence": math.ceil(196 * 0.4)},
    )  # fmt: skip
    assert seen["angles"]["zAngle"]["value"] == 1200


def test_what_is_out_of_range_is_said_to_be() -> None:
    far = track(
        position_m=(5000.0, -5000.0, 0.0), size_m=(40.0, 0.0, 3.0), age_s=90.0, velocity_mps=(300.0, -300.0, 0.0),
        covariance=[[1e4 * (i == j) for j in range(6)] for i in range(6)], track_id=65_536 + 3, label_confidence=0.0,
    )  # fmt: skip
    (content,) = messages_of(tracks(far), ORIGIN, 1)
    (seen,) = decode(encode(content))["containers"][5]["perceivedObjects"]
    assert (seen["position"]["xCoordinate"], seen["position"]["yCoordinate"]) == (
        {"value": 131_071, "confidence": 4095}, {"value": -131_072, "confidence": 4095},
    )  # fmt: skip
    assert seen["velocity"][1]["xVelocity"] == {"value": 16_382, "confidence": 126}
    assert (seen["objectDimensionX"]["value"], seen["objectDimensionY"]["value"]) == (255, 1)
    assert (seen["objectId"], seen["objectAge"], seen["classification"][0]["confidence"]) == (3, 2047, 1)


def test_many_tracks_are_told_in_segments_and_tentative_ones_not() -> None:
    many = [track(k, score=1 - k / 1000) for k in range(MAX_OBJECTS + 5)]
    first, second = (decode(encode(one)) for one in messages_of(tracks(*many, track(99, state="tentative")), ORIGIN, 1))
    assert first["managementContainer"]["segmentationInfo"] == {"totalMsgNo": 2, "thisMsgNo": 1}
    assert second["containers"][5]["numberOfPerceivedObjects"] == 5
    ids = [one["objectId"] for part in (first, second) for one in part["containers"][5]["perceivedObjects"]]
    assert ids == list(range(MAX_OBJECTS + 5))
    (empty,) = messages_of(tracks(), ORIGIN, 1, with_sensors=False)
    assert decode(encode(empty))["containers"] == {2: {}, 5: {"numberOfPerceivedObjects": 0, "perceivedObjects": []}}
    sizes = [len(encode(one)) for one in messages_of(tracks(*many[:MAX_OBJECTS]), ORIGIN, 1)]
    assert max(sizes) < 1000


@settings(max_examples=60, deadline=None)
@given(
    x=st.floats(-1300, 1300), y=st.floats(-1300, 1300), z=st.floats(-20, 20), heading=st.floats(-360, 360),
    yaw=st.floats(-math.pi, math.pi), speed=st.floats(-100, 100), score=st.floats(0, 1), age=st.floats(0, 1e6),
)  # fmt: skip
def test_any_track_comes_back_as_it_was(
    x: float, y: float, z: float, heading: float, yaw: float, speed: float, score: float, age: float
) -> None:
    origin = MapOrigin(latitude_deg=-33.0, longitude_deg=151.0, heading_deg=heading)
    one = track(position_m=(x, y, z), velocity_mps=(speed, 0.0, 0.0), yaw_rad=yaw, score=score, age_s=age)
    (content,) = messages_of(tracks(one), origin, 1)
    back = decode(encode(content))
    assert back == {**content, "containers": back["containers"]}
    (seen,) = back["containers"][5]["perceivedObjects"]
    east, north = seen["position"]["xCoordinate"]["value"] / 100, seen["position"]["yCoordinate"]["value"] / 100
    turn = math.radians(heading - 90.0)
    if max(abs(east), abs(north)) < 1310:
        assert math.cos(turn) * east - math.sin(turn) * north == pytest.approx(x, abs=0.011)
        assert math.sin(turn) * east + math.cos(turn) * north == pytest.approx(y, abs=0.011)
    assert 0 <= seen["angles"]["zAngle"]["value"] < 3600


@pytest.mark.parametrize(
    "data", [b"", b"\x02\x0e", whole_message()[:-20], b"\xff" * 60], ids=["nothing", "head", "cut", "ones"]
)
def test_what_is_no_message_is_refused(data: bytes) -> None:
    with pytest.raises(CpmError):
        decode(data)


def test_a_value_outside_of_its_range_is_refused_by_name() -> None:
    (content,) = messages_of(tracks(track()), ORIGIN, 1)
    content["header"]["stationId"] = -1
    with pytest.raises(CpmError, match="stationId"):
        encode(content)


@pytest.mark.parametrize(
    ("more", "accept", "why"),
    [
        ({}, False, ""),
        ({"state": "degraded", "reason": "rain"}, False, "the sensor is degraded: rain"),
        ({"source_kind": "simulated"}, False, "the tracks are simulated, not live"),
        ({"source_kind": "simulated"}, True, ""),
        ({"source_kind": "unknown"}, False, "the tracks are unknown, not live"),
        ({"frame_id": "lidar"}, False, "the tracks are in the frame lidar, not map"),
    ],
)
def test_only_what_is_live_and_seen_well_is_told_to_others(more: dict[str, str], accept: bool, why: str) -> None:
    message = tracks(track())
    for name, value in more.items():
        setattr(message, name, value)
    assert why_not(message, accept).startswith(why) if why else why_not(message, accept) == ""
