"""Messages travel as plain msgpack, come back equal, and nothing hostile takes a reader down."""

from __future__ import annotations

import math
from typing import Any

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common import messages as m
from common.codec import DecodeError, decode, encode, encoding_of, to_builtins
from common.topics import DATA_TOPICS

HEADER: dict[str, Any] = {"stamp_ns": 1_700_000_000_000_000_000, "seq": 7, "frame_id": "test"}
ZONE = m.LidarZone(nearest_m=0.4, points=9, level="IMMINENT")
TRACK = m.ObjectTrack(
    track_id=3, label="car", label_confidence=0.9, position_m=(1.0, 2.0, 0.7), velocity_mps=(3.0, 0.0, 0.0),
    covariance=np.eye(6).tolist(), size_m=(4.5, 1.8, 1.5), yaw_rad=0.1, age_s=2.0, score=0.8, state="confirmed",
    points=120,
)  # fmt: skip
EXAMPLES: list[m.Message] = [
    m.RadarTracks(**HEADER, tracks=[], level="SAFE", settled=True, noise_floor_db=-50.0),
    m.RadarDetections(
        **HEADER,
        detections=[m.RadarDetection(range_m=1.0, azimuth_rad=None, velocity_mps=-1.0, snr_db=20.0)],
        range_doppler_db=np.arange(12, dtype=np.float32).reshape(3, 4),
        range_axis_m=np.arange(3.0),
        velocity_axis_mps=np.arange(4.0),
    ),
    m.LaserScan(
        **HEADER,
        angles_rad=np.linspace(0, 1, 5, dtype=np.float32),
        ranges_m=np.ones(5, np.float32),
        confidence=np.full(5, 200, np.uint8),
    ),
    m.LidarZones(**HEADER, left=ZONE, centre=ZONE, right=ZONE, level="IMMINENT", raw_level="SAFE"),
    m.CameraDetections(
        **HEADER,
        detections=[
            m.CameraDetection(
                label="person",
                confidence=0.8,
                box_xyxy_px=(1.0, 2.0, 3.0, 4.0),
                distance_m=2.0,
                level="SAFE",
                in_zone=True,
                truncated=False,
            )
        ],
        brightness=100.0,
        level="SAFE",
        image_size_px=(640, 480),
    ),
    m.CompressedImage(**HEADER, format="jpeg", data=b"\xff\xd8"),
    m.ObjectTracks(**HEADER, tracks=[TRACK]),
    m.Clusters(**HEADER, clusters=[]),
    m.PointCloud(
        **HEADER,
        points=np.zeros((0, 3), np.float32),
        intensity=np.zeros(0, np.uint8),
        kind=np.zeros(0, np.uint8),
    ),
    m.EgoMotion(**HEADER, speed_mps=None, yaw_rate_radps=0.1, T_map_vehicle=np.eye(4).tolist()),
    m.GateState(
        **HEADER,
        permission="SLOW",
        limit_mps=0.5,
        cause="verdict",
        because="near",
        left_s=0.0,
        acknowledge=False,
        verdict_seq=None,
        verdict_age_s=None,
        outputs={"sim:": "SLOW"},
    ),
    m.Verdict(
        **HEADER,
        level="SAFE",
        rule="R1",
        because="nothing near",
        inputs={},
        confirmed=False,
        suppressed=False,
        advisory=None,
        blind=False,
        permission="GO",
    ),
    m.FusionTrace(**HEADER, verdict_seq=3, inputs={"now_s": 1.5}, memory={}, rules={"suppression": "limited"}),
    m.SystemHealth(**HEADER, sensors={}, colour="green", summary="ALL VEHICLE SENSORS ONLINE", services={}),
]
by_name = pytest.mark.parametrize("message", EXAMPLES, ids=lambda message: type(message).__name__)


def test_every_topic_has_an_example() -> None:
    assert {type(example) for example in EXAMPLES} == {topic.message for topic in DATA_TOPICS}


@by_name
def test_round_trip(message: m.Message) -> None:
    assert to_builtins(decode(encode(message), type(message))) == to_builtins(message)


@by_name
def test_plain_msgpack_reads_it(message: m.Message) -> None:
    plain = msgpack.unpackb(encode(message))
    assert list(plain)[:3] == ["stamp_ns", "seq", "frame_id"]
    assert set(plain) == set(message.__struct_fields__)
    assert encoding_of(type(message)) == f"application/msgpack;spotter.{type(message).__name__}.v1"


def test_arrays_are_views_of_the_payload() -> None:
    payload = encode(EXAMPLES[2])
    scan = decode(payload, m.LaserScan)
    assert not scan.ranges_m.flags.owndata
    assert not scan.ranges_m.flags.writeable
    assert np.shares_memory(scan.ranges_m, np.frombuffer(payload, np.uint8))


def test_array_layout_on_the_wire() -> None:
    plain = msgpack.unpackb(encode(EXAMPLES[1]))["range_doppler_db"]
    assert plain == {"dtype": "<f4", "shape": [3, 4], "data": np.arange(12, dtype="<f4").tobytes()}


def test_big_endian_bool_and_strided_arrays_travel() -> None:
    scan = m.LaserScan(
        **HEADER,
        angles_rad=np.arange(4, dtype=">f4"),
        ranges_m=np.arange(8, dtype=np.float32)[::2],
        confidence=np.array([True, False, True, False]),
    )
    back = decode(encode(scan), m.LaserScan)
    assert back.angles_rad.tolist() == [0, 1, 2, 3]
    assert back.ranges_m.tolist() == [0, 2, 4, 6]
    assert back.confidence.tolist() == [1, 0, 1, 0]


def test_unsupported_dtype_is_refused_when_encoding() -> None:
    cloud = m.PointCloud(
        **HEADER, points=np.zeros((1, 3), complex), intensity=np.zeros(1, np.uint8), kind=np.zeros(1, np.uint8)
    )
    with pytest.raises(ValueError, match=r"PointCloud\.points: dtype <c16"):
        encode(cloud)


def test_unknown_fields_are_ignored() -> None:
    plain = msgpack.unpackb(encode(EXAMPLES[0])) | {"from_the_future": [1, {"a": None}]}
    assert decode(msgpack.packb(plain), m.RadarTracks).level == "SAFE"


@pytest.mark.parametrize("field", ["stamp_ns", "seq", "frame_id", "tracks", "level", "settled"])
def test_a_missing_field_is_named(field: str) -> None:
    plain = msgpack.unpackb(encode(EXAMPLES[0]))
    del plain[field]
    with pytest.raises(DecodeError, match=f"RadarTracks: .*`{field}`"):
        decode(msgpack.packb(plain), m.RadarTracks)


@pytest.mark.parametrize(
    ("field", "value", "error_text"),
    [
        ("level", "DANGER", "Invalid enum value 'DANGER'"),
        ("stamp_ns", -1, ">= 0"),
        ("stamp_ns", "now", "got `str`"),
        ("noise_floor_db", math.nan, "noise_floor_db"),
        ("noise_floor_db", math.inf, "noise_floor_db"),
        ("tracks", [{}], "missing required field"),
        ("tracks", {}, "Expected `array`"),
    ],
)
def test_ill_typed_and_unreal_values_are_refused(field: str, value: object, error_text: str) -> None:
    plain = msgpack.unpackb(encode(EXAMPLES[0])) | {field: value}
    with pytest.raises(DecodeError, match=error_text):
        decode(msgpack.packb(plain), m.RadarTracks)


def test_a_million_tracks_are_refused() -> None:
    plain = msgpack.unpackb(encode(EXAMPLES[6]))
    plain["tracks"] = [0] * 1_000_000
    with pytest.raises(DecodeError, match="length <= 2000"):
        decode(msgpack.packb(plain), m.ObjectTracks)


@pytest.mark.parametrize(
    ("array", "error_text"),
    [
        ({"dtype": "<f4", "shape": [5], "data": b"123"}, "needs 20 bytes, got 3"),
        ({"dtype": "O", "shape": [5], "data": b"123"}, "dtype 'O'"),
        ({"dtype": "<f4", "shape": [2**40, 2**40], "data": b""}, "needs"),
        ({"dtype": "<f4", "shape": [-1], "data": b""}, ">= 0"),
        ({"dtype": "<f4", "shape": [0, 2**62], "data": b""}, "is no shape"),
        ({"dtype": "<f4", "shape": [2**64 - 1, 0], "data": b""}, "is no shape"),
        ({"dtype": "<f4", "shape": [6], "data": bytes(24)}, "expected shape"),
        ({"dtype": "<f4", "shape": [1, 5], "data": bytes(20)}, "expected shape"),
        ([1.0, 2.0], "Expected `object`"),
    ],
)
def test_arrays_that_lie_are_refused(array: object, error_text: str) -> None:
    plain = msgpack.unpackb(encode(EXAMPLES[2])) | {"ranges_m": array}
    with pytest.raises(DecodeError, match=error_text):
        decode(msgpack.packb(plain), m.LaserScan)


def test_oversized_payload_is_refused_unread() -> None:
    with pytest.raises(DecodeError, match="allowed 100"):
        decode(bytes(101), m.Verdict, max_bytes=100)


@given(st.binary(max_size=400))
def test_any_bytes_decode_or_are_refused(payload: bytes) -> None:
    for topic in DATA_TOPICS:
        try:
            decode(payload, topic.message)
        except DecodeError:
            continue


@given(st.data())
def test_damaged_messages_decode_or_are_refused(data: st.DataObject) -> None:
    message = data.draw(st.sampled_from(EXAMPLES))
    payload = bytearray(encode(message))
    for _ in range(data.draw(st.integers(1, 4))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    cut = bytes(payload[: data.draw(st.integers(0, len(payload)))])
    try:
        decode(cut, type(message))
    except DecodeError:
        return


json_like = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text() | st.binary(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=10,
)


@given(st.sampled_from(EXAMPLES), st.data())
def test_any_value_in_any_field_decodes_or_is_refused(message: m.Message, data: st.DataObject) -> None:
    plain = msgpack.unpackb(encode(message))
    plain[data.draw(st.sampled_from(sorted(plain)))] = data.draw(json_like)
    try:
        decode(msgpack.packb(plain), type(message))
    except DecodeError:
        return


def test_deep_nesting_is_refused() -> None:
    with pytest.raises(DecodeError):
        decode(b"\x91" * 100_000 + b"\xc0", m.Verdict)


def test_builtins_can_become_json() -> None:
    assert b"range_doppler_db" in msgspec.json.encode(to_builtins(EXAMPLES[1]))
