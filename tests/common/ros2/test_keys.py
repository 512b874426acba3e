"""Keys, tokens and attachments as rmw_zenoh's design document has them, and as another hand writes them."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.ros2.keys import (
    SENSOR_DATA,
    Attachment,
    Entity,
    Qos,
    RosNameError,
    attachment_of,
    dds_name,
    entity_of,
    name_of_dds,
    topic_key,
    topic_name,
    type_and_hash,
    type_name,
)

STRING = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


@pytest.mark.parametrize(
    ("domain", "topic", "key"),
    [  # rmw_zenoh, docs/design.md, "Topic and Service name mapping"
        (0, "/chatter", f"0/chatter/std_msgs::msg::dds_::String_/{STRING}"),
        (0, "/robot1/chatter", f"0/robot1/chatter/std_msgs::msg::dds_::String_/{STRING}"),
    ],
)
def test_topic_keys_are_those_of_the_design_document(domain: int, topic: str, key: str) -> None:
    assert topic_key(domain, topic, "std_msgs/msg/String", STRING) == key
    assert type_and_hash(key) == ("std_msgs/msg/String", STRING)


LISTENER = Entity(2, "aac3178e146ba6f1fc6e6a4085e77f21", 0, 0, "NN", "/", "listener")
SUBSCRIPTION = Entity(
    2, "aac3178e146ba6f1fc6e6a4085e77f21", 0, 10, "MS", "/", "listener", "/chatter", "std_msgs/msg/String", STRING,
    str(Qos(depth=10)),
)  # fmt: skip
PUBLISHER = Entity(
    2, "8b20917502ee955ac4476e0266340d5c", 0, 10, "MP", "/", "talker", "/chatter", "std_msgs/msg/String", STRING,
    str(Qos(depth=7)),
)  # fmt: skip
CHATTER = f"%chatter/std_msgs::msg::dds_::String_/{STRING}"


@pytest.mark.parametrize(
    ("entity", "token"),
    [  # rmw_zenoh, docs/design.md, "Graph Cache"
        (LISTENER, "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener"),
        (SUBSCRIPTION, f"@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MS/%/%/listener/{CHATTER}/::,10:,:,:,,"),
        (PUBLISHER, f"@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/{CHATTER}/::,7:,:,:,,"),
    ],
)
def test_tokens_are_those_of_the_design_document(entity: Entity, token: str) -> None:
    assert str(entity) == token
    assert entity_of(token) == entity


@pytest.mark.parametrize(
    ("qos", "text"),
    [
        (Qos(), "::,10:,:,:,,"),
        (SENSOR_DATA, "2::,5:,:,:,,"),
        (Qos(transient_local=True, depth=1), ":1:,1:,:,:,,"),
    ],
)
def test_qualities_of_service(qos: Qos, text: str) -> None:
    assert str(qos) == text


NAMES = st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True)
PATHS = st.lists(NAMES, min_size=1, max_size=3).map(lambda names: "/" + "/".join(names))


@settings(max_examples=20)
@given(st.integers(0, 232), NAMES, PATHS, NAMES, PATHS, st.integers(0, 99), st.sampled_from(["MP", "MS"]))
def test_a_token_read_is_the_entity_that_wrote_it(domain, session, namespace, node, topic, entity, kind) -> None:
    of_humble = "TypeHashNotSupported"
    written = Entity(domain, session, 0, entity, kind, namespace, node, topic, "a_msgs/msg/B", of_humble, str(Qos()))
    assert entity_of(str(written)) == written


def test_what_a_later_release_may_append_to_a_token_is_left_out() -> None:
    assert entity_of(f"{PUBLISHER}/more") == PUBLISHER


@pytest.mark.parametrize(
    "token",
    ["@ros2_lv", "@ros2_lv/0/a/0/0/NN/%/%", "@ros2_lv/x/a/0/0/NN/%/%/n", "@ros2_lv/0/a/0/0/QQ/%/%/n",
     "@ros2_lv/0/a/0/1/MP/%/%/n", "0/a/0/0/0/NN/%/%/n", "pi0/radar/alive/12345678"],
)  # fmt: skip
def test_what_is_no_token_of_ros_is_none(token: str) -> None:
    assert entity_of(token) is None


def test_the_attachment_is_laid_out_as_the_design_document_says() -> None:
    """8 bytes sequence, 8 bytes time, 1 byte length, 16 bytes GID; little-endian."""
    attachment = Attachment(1, 0x0102030405060708, bytes(range(16)))
    assert bytes(attachment) == bytes.fromhex("0100000000000000 0807060504030201 10") + bytes(range(16))
    assert attachment_of(bytes(attachment)) == attachment


@given(st.binary(max_size=80))
def test_another_attachment_is_none_and_never_raises(data: bytes) -> None:
    found = attachment_of(data)
    assert found is None or bytes(found) == data


@pytest.mark.parametrize("text", ["", "/", "/a//b", "/1a", "/a b", "/a*", "/a/%"])
def test_a_wrong_topic_is_refused(text: str) -> None:
    with pytest.raises(RosNameError, match="topic"):
        topic_name(text)


def test_names_of_types() -> None:
    assert type_name("sensor_msgs/PointCloud2") == type_name("sensor_msgs/msg/PointCloud2")
    assert name_of_dds(dds_name("sensor_msgs/msg/PointCloud2")) == "sensor_msgs/msg/PointCloud2"
    with pytest.raises(RosNameError, match="package/msg/Type"):
        type_name("PointCloud2")


def test_another_hand_writes_the_same() -> None:
    """zenoh-ros2-sdk: keys, tokens, quality of service and attachments of the same things."""
    keyexpr = pytest.importorskip("zenoh_ros2_sdk.keyexpr", reason="zenoh-ros2-sdk (extra dev) is not installed")
    from zenoh_ros2_sdk.attachment import Attachment as TheirAttachment
    from zenoh_ros2_sdk.entity import EndpointEntity, EntityKind, NodeEntity
    from zenoh_ros2_sdk.qos import QosDurability, QosProfile, QosReliability
    from zenoh_ros2_sdk.utils import ros2_to_dds_type

    node = NodeEntity(3, "abc", 0, "lidar", "/pole")
    for ours, theirs in [
        (Qos(), QosProfile()),
        (SENSOR_DATA, QosProfile(reliability=QosReliability.BEST_EFFORT, history_depth=5)),
        (Qos(transient_local=True, depth=1), QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=1)),
    ]:
        assert str(ours) == theirs.encode()
        for kind in (EntityKind.PUBLISHER, EntityKind.SUBSCRIPTION):
            dds = ros2_to_dds_type("std_msgs/msg/String")
            entity = EndpointEntity(node, 4, kind, "/pole/words", dds, STRING, theirs.encode())
            our = Entity(
                3, "abc", 0, 4, kind.value, "/pole", "lidar", "/pole/words", "std_msgs/msg/String", STRING, str(ours)
            )
            assert str(our) == keyexpr.endpoint_liveliness_keyexpr(entity)
            assert topic_key(3, our.topic, our.type_, STRING) == keyexpr.topic_keyexpr(3, our.topic, dds, STRING)
    assert str(Entity(3, "abc", 0, 0, "NN", "/pole", "lidar")) == keyexpr.node_liveliness_keyexpr(node)
    assert bytes(Attachment(7, 8, bytes(16))) == TheirAttachment(7, 8, bytes(16)).to_bytes()
