"""Hashes against published ones and another implementation; CDR against a plain one, for the whole table of types."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from common.ros2.types import DEFINITIONS, CdrError, build, from_cdr, ns_of, time_of, to_cdr, type_hash, type_store
from tests.common.ros2.plain_cdr import plain_cdr

PUBLISHED = {  # as they stand in keys and tokens of running systems, and in rmw_zenoh's design document
    "std_msgs/msg/String": "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "sensor_msgs/msg/PointCloud2": "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
    "sensor_msgs/msg/Image": "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
    "sensor_msgs/msg/Imu": "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
    "nav_msgs/msg/Odometry": "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    "tf2_msgs/msg/TFMessage": "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
}
OURS = sorted(f"{path.parent.name}/msg/{path.stem}" for path in DEFINITIONS.glob("*/*.msg"))
TABLE = [
    "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/Image", "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/CompressedImage", "nav_msgs/msg/Odometry", "diagnostic_msgs/msg/DiagnosticArray",
    "visualization_msgs/msg/MarkerArray", "tf2_msgs/msg/TFMessage", *OURS,
]  # fmt: skip


def reference_store() -> Any:
    """Made here, so that the definitions are read once more."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types: dict[str, Any] = {}
    for path in DEFINITIONS.glob("*/*.msg"):
        types |= get_types_from_msg(path.read_text(), f"{path.parent.name}/msg/{path.stem}")
    store.register(types)
    return store


STORE = reference_store()
PARTS = {about[0][1] for name in TABLE for _, (kind, about) in STORE.fielddefs[name][1] if int(kind) == 4}
WHOLE = [name for name in TABLE if name not in PARTS]  # what is published or read; its parts are in it
# A byte is signed for the library; levels of diagnostics, the only ones here, are 0 to 3.
RANGES = {"byte": (0, 127), **{f"{sign}int{bits}": ((0 if sign else -(2 ** (bits - 1))), 2 ** (bits - (not sign)) - 1)
          for sign in ("", "u") for bits in (8, 16, 32, 64)}}  # fmt: skip


def random_value(description: Any, rng: np.random.Generator) -> Any:
    kind, about = int(description[0]), description[1]
    if kind == 1:
        if about[0] == "string":
            return "".join(chr(c) for c in rng.integers(32, 0x2FF, rng.integers(0, 9)))
        if about[0] == "bool":
            return bool(rng.integers(2))
        if about[0].startswith("float"):
            return float(np.float32(rng.normal()))
        low, high = RANGES[about[0]]
        return int(rng.integers(low, high, endpoint=True, dtype=np.uint64 if low == 0 else np.int64))
    if kind == 2:
        return random_message(about, rng)
    element, count = about
    values = [random_value(element, rng) for _ in range(count if kind == 3 else rng.integers(0, 4))]
    return np.array(values, element[1][0]) if int(element[0]) == 1 and element[1][0] != "string" else values


def random_message(name: str, rng: np.random.Generator) -> Any:
    return build(name, **{field: random_value(about, rng) for field, about in STORE.fielddefs[name][1]})


@pytest.mark.parametrize("name", WHOLE)
@settings(max_examples=8)
@given(seed=st.integers(0, 2**32 - 1))
def test_cdr_is_that_of_a_plain_writer_bit_for_bit_and_reads_back(name: str, seed: int) -> None:
    message = random_message(name, np.random.default_rng(seed))
    data = to_cdr(message)
    assert data == plain_cdr(STORE.fielddefs, name, message)
    assert data == bytes(STORE.serialize_cdr(message, name))
    assert to_cdr(from_cdr(data, name)) == data


@pytest.mark.parametrize(("name", "published"), PUBLISHED.items())
def test_hashes_are_the_published_ones(name: str, published: str) -> None:
    assert type_hash(name) == published


@pytest.mark.parametrize("distribution", [Stores.ROS2_IRON, Stores.ROS2_KILTED, Stores.ROS2_LYRICAL])
def test_hashes_are_the_same_in_every_distribution(distribution: Stores) -> None:
    store = get_typestore(distribution)
    for name in TABLE:
        if name not in OURS:
            assert store.hash_rihs01(name) == type_hash(name)


@pytest.mark.parametrize("name", TABLE)
def test_hashes_are_those_of_another_implementation(name: str) -> None:
    utils = pytest.importorskip("zenoh_ros2_sdk.utils", reason="zenoh-ros2-sdk (extra dev) is not installed")
    own, *parts = STORE.generate_msgdef(name, ros_version=2)[0].split("=" * 80 + "\n")
    needed = {}
    for part in parts:
        head, _, text = part.partition("\n")
        package, last = head.removeprefix("MSG: ").split("/")
        needed[f"{package}/msg/{last}"] = text
    assert type_hash(name) == utils.compute_type_hash_from_msg(name, own, needed)


def test_every_type_of_the_table_is_known() -> None:
    assert set(TABLE) <= set(type_store().fielddefs)


def test_what_is_not_given_is_zero_and_a_wrong_field_is_refused() -> None:
    scan = build("sensor_msgs/msg/LaserScan", ranges=[1, 2.5])
    assert scan.ranges.dtype == np.float32
    assert list(scan.ranges) == [1.0, 2.5]
    assert (scan.header.frame_id, scan.header.stamp.sec, scan.angle_min, len(scan.intensities)) == ("", 0, 0.0, 0)
    with pytest.raises(TypeError, match="no field rages"):
        build("sensor_msgs/msg/LaserScan", rages=[1])


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_times_keep_every_nanosecond(ns: int) -> None:
    assert ns_of(time_of(ns)) == ns


@pytest.mark.parametrize("name", WHOLE)
@settings(max_examples=8)
@given(seed=st.integers(0, 2**32 - 1), cut=st.floats(0, 1), flips=st.lists(st.integers(0, 10**6), max_size=4))
def test_damaged_bytes_are_refused_or_read_and_nothing_else(name: str, seed: int, cut: float, flips: list[int]) -> None:
    data = bytearray(to_cdr(random_message(name, np.random.default_rng(seed))))
    data = data[: round(cut * len(data))]
    for flip in flips:
        if data:
            data[flip // 8 % len(data)] ^= 1 << flip % 8
    try:
        from_cdr(bytes(data), name)
    except CdrError:
        return
