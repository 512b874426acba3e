"""A reader on a real router: what comes through, and the sentence for everything that does not."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh

from common.bus.session import build as build_config
from common.bus.session import open_session
from common.bus.status import Report
from common.clock import utc_ns
from common.config import ZenohConfig
from common.ros2.keys import SENSOR_DATA, Attachment, topic_key
from common.ros2.node import Node, RosPublisher
from common.ros2.reader import TopicReader
from common.ros2.source import RosTopic
from common.ros2.types import build, header, to_cdr, type_hash

SCAN = "sensor_msgs/msg/LaserScan"
S = 1_000_000_000


@pytest.fixture
def ros(router_endpoint: str) -> Iterator[zenoh.Session]:
    """A session as a ROS node would have: no namespace."""
    with open_session(ZenohConfig(namespace="", connect=(router_endpoint,))) as session:
        yield session


@pytest.fixture
def listening(router_endpoint: str, ros: zenoh.Session) -> Iterator[Callable[..., TopicReader]]:
    opened = []

    def listen(**about: Any) -> TopicReader:
        reader = TopicReader(
            RosTopic("/scan", SCAN, **about), ZenohConfig(namespace="", connect=(router_endpoint,)), Report("t"), "us"
        )
        opened.append(reader)
        return reader.__enter__()

    yield listen
    for reader in opened:
        reader.__exit__()


def scan(stamp_ns: int, ranges: tuple[float, ...] = (1.0,)) -> Any:
    return build(SCAN, header=header(stamp_ns, "lidar"), ranges=ranges)


def counters(reader: TopicReader) -> dict[str, int]:
    return reader._report.snapshot().counters


def connected(until: Callable[..., None], publisher: RosPublisher) -> RosPublisher:
    until(lambda: publisher.wanted, "the reader's subscription is known")
    return publisher


def put(until: Callable[..., None], ros: zenoh.Session, key: str, payload: bytes) -> None:
    """Once, when somebody listens to it."""
    publisher: Any = ros.declare_publisher(key)
    until(lambda: publisher.matching_status.matching, f"somebody listens to {key}")
    publisher.put(payload)


def says(until: Callable[..., None], reader: TopicReader, words: str) -> None:
    """The reason is this sentence, once everything on the way has arrived."""

    def it_does() -> bool:
        assert reader.next(0.0) is None
        return words in reader.why_nothing()

    until(it_does, words)


def test_a_message_comes_with_its_measurement_s_time(listening, ros, until) -> None:
    reader = listening()
    publish = connected(until, Node(ros, "driver").publisher("/scan", SCAN, SENSOR_DATA))
    stamp_ns = utc_ns() - 20_000_000
    publish(scan(stamp_ns, (1.0, 2.5)))
    arrived = reader.next(10.0)
    assert arrived is not None
    assert (arrived.stamp_ns, list(arrived.message.ranges)) == (stamp_ns, [1.0, 2.5])
    assert stamp_ns < arrived.received_ns <= utc_ns()


def test_every_silence_has_its_sentence_and_ends_by_itself(listening, ros, until) -> None:
    reader = listening()
    says(until, reader, "nobody publishes it in domain 0 (is its router the one that is asked")
    node = Node(ros, "driver")
    node.announce("MP", "/other", SCAN, SENSOR_DATA)
    says(until, reader, "nobody publishes it in domain 0; there: /other")
    node.announce("MP", "/scan", "sensor_msgs/msg/Image", SENSOR_DATA)
    says(until, reader, "is sensor_msgs/msg/Image of node /driver, expected sensor_msgs/msg/LaserScan")
    publish = connected(until, node.publisher("/scan", SCAN, SENSOR_DATA))
    says(until, reader, "node /driver publishes it but sends nothing; check the sensor behind it")
    publish(scan(utc_ns()))
    assert reader.next(10.0) is not None


def test_another_type_and_another_definition_are_refused_by_name(listening, ros, until) -> None:
    reader = listening()
    put(until, ros, topic_key(0, "/scan", "sensor_msgs/msg/Image", "RIHS01_00"), b"")
    says(until, reader, "carries sensor_msgs/msg/Image, expected sensor_msgs/msg/LaserScan")
    put(until, ros, topic_key(0, "/scan", SCAN, "RIHS01_0011223344"), to_cdr(scan(utc_ns())))
    says(
        until, reader, "carries another definition of sensor_msgs/msg/LaserScan (RIHS01_00112233) than ours (RIHS01_64"
    )
    assert counters(reader) == {"message of another type": 1, "message of another definition": 1}
    reader.__exit__()
    reader = listening(any_hash=True)
    put(until, ros, topic_key(0, "/scan", SCAN, "TypeHashNotSupported"), to_cdr(scan(utc_ns())))
    assert reader.next(10.0) is not None, "a message of Humble, where that is allowed"


def test_wrong_stamps_and_broken_bytes_are_told_and_the_next_good_one_counts(listening, ros, until) -> None:
    reader = listening()
    publish = connected(until, Node(ros, "driver").publisher("/scan", SCAN, SENSOR_DATA))
    publish(scan(0))
    says(until, reader, "header.stamp is zero; date by arrival")
    publish(scan(utc_ns() + 3 * S))
    says(until, reader, "ahead of this machine's clock; synchronise the clocks")
    put(until, ros, topic_key(0, "/scan", SCAN, type_hash(SCAN)), b"\x00\x01\x00\x00broken")
    says(until, reader, "no sensor_msgs/msg/LaserScan")
    stamp_ns = utc_ns()
    publish(scan(stamp_ns))
    assert reader.next(10.0) is not None
    publish(scan(stamp_ns))
    until(lambda: reader.next(0.05) is None and counters(reader).get("message repeated or out of order") == 1)
    assert "sends nothing" in reader.why_nothing()
    assert counters(reader)["wrong stamp"] == 2
    assert counters(reader)["undecodable message"] == 1


def test_dated_by_arrival_where_that_is_asked_for(listening, ros, until) -> None:
    reader = listening(stamp="arrival")
    publish = connected(until, Node(ros, "driver").publisher("/scan", SCAN, SENSOR_DATA))
    publish(scan(0))
    arrived = reader.next(10.0)
    assert arrived is not None
    assert arrived.stamp_ns == arrived.received_ns


def test_what_is_missing_between_two_messages_is_counted(listening, ros, until) -> None:
    reader = listening()
    key, gid = topic_key(0, "/scan", SCAN, type_hash(SCAN)), bytes(16)
    publisher: Any = ros.declare_publisher(key)
    until(lambda: publisher.matching_status.matching)
    for sequence in (4, 5, 9):
        publisher.put(to_cdr(scan(utc_ns())), attachment=bytes(Attachment(sequence, utc_ns(), gid)))
        assert reader.next(10.0) is not None
    assert counters(reader)["message lost"] == 3


def test_a_slow_reader_gets_the_newest(listening, ros, until) -> None:
    reader = listening()
    publish = connected(until, Node(ros, "driver").publisher("/scan", SCAN, SENSOR_DATA))
    for k in range(5):
        publish(scan(utc_ns(), (float(k),)))
    until(lambda: reader._report.snapshot().dropped == 3)
    taken = [reader.next(1.0), reader.next(1.0)]
    assert [list(one.message.ranges) for one in taken if one] == [[3.0], [4.0]]


def test_it_comes_back_when_the_router_has_been_away(free_ports: Callable[[], int], until) -> None:
    config = ZenohConfig(namespace="", connect=(f"tcp/127.0.0.1:{free_ports()}",), lease_ms=1000)
    router = ZenohConfig(mode="router", namespace="", connect=(), listen=config.connect)
    running = zenoh.open(build_config(router))
    topic = RosTopic("/scan", SCAN, stamp="arrival")
    with TopicReader(topic, config, Report("t"), "us") as reader, open_session(config) as ros:
        publish = connected(until, Node(ros, "driver").publisher("/scan", SCAN, SENSOR_DATA))
        publish(scan(0))
        assert reader.next(10.0) is not None
        running.close()
        until(lambda: reader.graph.publishers() == [], "the publisher is gone")
        assert "nobody publishes it" in reader.why_nothing()
        running = zenoh.open(build_config(router))
        until(lambda: publish(scan(0)) or reader.next(0.05) is not None, "messages come again")
        until(lambda: [one.full_node for one in reader.graph.publishers()] == ["/driver"])
    running.close()


def test_a_router_that_is_away_is_named_and_waited_for(
    free_ports: Callable[[], int], until: Callable[..., None]
) -> None:
    endpoint, report = f"tcp/127.0.0.1:{free_ports()}", Report("t")
    reader = TopicReader(RosTopic("/scan", SCAN), ZenohConfig(namespace="", connect=(endpoint,)), report, "us")
    opening = threading.Thread(target=reader.__enter__, daemon=True)
    opening.start()
    until(lambda: f"no router answers at {endpoint}" in report.snapshot().reason, "the reason names the router")
    with zenoh.open(build_config(ZenohConfig(mode="router", connect=(), listen=(endpoint,), namespace=""))):
        opening.join(10.0)
        assert not opening.is_alive()
        reader.__exit__()
