"""The address of a topic, and when its messages were measured."""

from __future__ import annotations

import pytest

from common.config import ConfigError, ZenohConfig
from common.ros2.source import ROS2_PARAMETERS, RosTopic, ros_session, ros_topic
from common.ros2.stamps import StampError, measured_ns
from common.source_url import parse_source, source_kind

TYPES = ("sensor_msgs/msg/PointCloud2", "velodyne_msgs/msg/VelodyneScan")
ALLOWED = {"ros2": ROS2_PARAMETERS}


def topic(text: str) -> RosTopic:
    return ros_topic(parse_source(text, ALLOWED), TYPES)


def test_the_address_of_a_topic() -> None:
    assert topic("ros2:/points") == RosTopic("/points", TYPES[0])
    assert topic("ros2:points?domain=7&stamp=arrival&hash=any&type=velodyne_msgs/VelodyneScan") == RosTopic(
        "/points", TYPES[1], 7, "arrival", True
    )
    assert source_kind("ros2:/points?type=a/B") == "live"
    assert source_kind("ros2:/points?domain=7&kind=simulated") == "simulated"
    assert source_kind("ros2:/points?kind=real") == "unknown"
    assert source_kind("ros2:/odom + ros2:/imu?kind=recorded") == "recorded"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("ros2:", "is no topic's name"),
        ("ros2:/poi nts", "is no topic's name"),
        ("ros2:/points?type=sensor_msgs/msg/Image", "sensor_msgs/msg/Image is not read here; allowed: sensor_msgs/"),
        ("ros2:/points?type=Image", "expected package/msg/Type"),
        ("ros2:/points?domain=233", "domain=233: expected 0 to 232"),
        ("ros2:/points?domain=x", "domain='x' is not a number"),
        ("ros2:/points?stamp=now", "stamp=now: expected header or arrival"),
        ("ros2:/points?hash=none", "hash=none: expected same or any"),
        ("ros2:/points?kind=real", "kind=real: expected live, recorded, emulated, simulated"),
        ("ros2:/points?rate=2", "no parameter 'rate'"),
    ],
)
def test_a_wrong_address_is_refused_with_what_is_allowed(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        topic(text)


def test_ros_topics_are_reached_outside_of_the_namespace() -> None:
    own = ZenohConfig(namespace="spotter", connect=("tls/pole:7448",), certificate="c", private_key="k")
    assert ros_session(parse_source("ros2:/a", ALLOWED), own) == ZenohConfig(
        namespace="", connect=("tls/pole:7448",), certificate="c", private_key="k"
    )
    other = ros_session(parse_source("ros2:/a?connect=tcp/ros:7447", ALLOWED), own)
    assert (other.namespace, other.connect, other.certificate) == ("", ("tcp/ros:7447",), "")


NOW_NS = 1_700_000_000_000_000_000
S = 1_000_000_000


@pytest.mark.parametrize("late_ns", [-50_000_000, 0, 1, 400_000_000, S])
def test_a_stamp_is_believed_within_its_bounds(late_ns: int) -> None:
    assert measured_ns(NOW_NS - late_ns, NOW_NS) == NOW_NS - late_ns


@pytest.mark.parametrize(
    ("stamp_ns", "words"),
    [
        (0, "is zero"),
        (NOW_NS + 50_000_001, "0.05 s ahead of this machine's clock; synchronise"),
        (NOW_NS - S - 1, "1.00 s behind"),
        (12 * S, "19675.9 days behind"),
    ],
)
def test_a_wrong_stamp_is_told_with_what_to_do(stamp_ns: int, words: str) -> None:
    with pytest.raises(StampError, match=words):
        measured_ns(stamp_ns, NOW_NS)
    assert measured_ns(stamp_ns, NOW_NS, "arrival") == NOW_NS
