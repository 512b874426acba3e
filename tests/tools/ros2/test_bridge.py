"""The bridge on real routers: what is offered, what is listened to, and that made-up data have a name of their own."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from common import topics
from common.bus.runtime import Service
from common.bus.session import open_session
from common.bus.status import Report
from common.clock import utc_ns
from common.codec import encode
from common.config import ServiceConfig, ZenohConfig
from common.messages import LaserScan
from common.ros2.node import Node, node_config
from common.ros2.reader import TopicReader
from common.ros2.source import RosTopic
from services.jetson.lidar.config import LidarConfig
from spotter_tools.cli.__main__ import app
from spotter_tools.ros2.bridge import Bridge
from spotter_tools.ros2.scans import LASER_SCAN
from spotter_tools.ros2.table import ROWS
from spotter_tools.ros2.transforms import TF

SITE = "site"


@pytest.fixture
def bridged(router_endpoint: str) -> Iterator[Bridge]:
    ours = open_session(ZenohConfig(namespace=SITE, connect=(router_endpoint,)))
    ros = open_session(node_config((router_endpoint,)))
    bridge, stop = Bridge(ours, Node(ros, "spotter"), ROWS, sensors=True), threading.Event()
    worker = threading.Thread(target=bridge.run, args=(stop,))
    worker.start()
    yield bridge
    stop.set()
    worker.join()
    bridge.close()
    ours.close()
    ros.close()


@pytest.fixture
def listen(router_endpoint: str) -> Iterator[Callable[[str, str], TopicReader]]:
    readers = []

    def reader_of(name: str, type_: str) -> TopicReader:
        config = ZenohConfig(namespace="", connect=(router_endpoint,))
        readers.append(TopicReader(RosTopic(name, type_), config, Report("t"), "rviz"))
        return readers[-1].__enter__()

    yield reader_of
    for reader in readers:
        reader.__exit__()


def scan(ranges: tuple[float, ...]) -> LaserScan:
    angles = np.linspace(-np.pi, np.pi, len(ranges), endpoint=False, dtype=np.float32)
    return LaserScan(
        stamp_ns=utc_ns(), angles_rad=angles, ranges_m=np.array(ranges, np.float32),
        confidence=np.full(len(ranges), 9, np.uint8),
    )  # fmt: skip


def publishers_of(reader: TopicReader, topic: str) -> list[Any]:
    """What the reader's graph knows of a topic; other topics of the node may be there before it."""
    return [one for one in reader.graph.publishers() if one.topic == topic]


def next_of(reader: TopicReader, publish: Callable[[], None]) -> Any:
    """Publish until one has come through: a message that is sent before somebody listens reaches nobody."""
    for _ in range(200):
        publish()
        arrived = reader.next(0.1)
        if arrived is not None:
            return arrived.message
    raise AssertionError(reader.why_nothing())


def test_scans_reach_ros_while_somebody_listens(router_endpoint: str, bridged: Bridge, listen, until) -> None:
    config = LidarConfig(
        source="serial:/dev/null", host="car", zenoh=ZenohConfig(namespace=SITE, connect=(router_endpoint,))
    )
    with Service("lidar", config) as service:
        publish = service.publisher(topics.LIDAR_SCAN)
        until(lambda: [line.name for line in bridged.lines()] == ["/spotter/car/lidar/scan"])
        (line,) = bridged.lines()
        publish(scan((1.0, 2.0)))
        assert line.subscriber is None, "nobody listens: nothing is asked for"
        reader = listen("/spotter/car/lidar/scan", LASER_SCAN)
        until(lambda: publishers_of(reader, "/spotter/car/lidar/scan") != [])
        (found,) = publishers_of(reader, "/spotter/car/lidar/scan")
        assert (found.full_node, found.qos) == ("/spotter", "2::,5:,:,:,,")
        message = next_of(reader, lambda: publish(scan((1.0, 2.0))))
        assert list(message.ranges) == [1.0, 2.0]
        reader.__exit__()
        until(lambda: line.subscriber is None, "the last listener has gone")


def test_simulated_data_stand_under_a_name_of_their_own(router_endpoint: str, bridged: Bridge, listen, until) -> None:
    config = LidarConfig(
        source="sim:crossing", host="car", zenoh=ZenohConfig(namespace=SITE, connect=(router_endpoint,))
    )
    with Service("lidar", config) as service:
        publish = service.publisher(topics.LIDAR_SCAN)
        until(lambda: bridged.lines() != [])
        assert [line.name for line in bridged.lines()] == ["/spotter_simulated/car/lidar/scan"]
        reader = listen("/spotter_simulated/car/lidar/scan", LASER_SCAN)
        assert list(next_of(reader, lambda: publish(scan((1.0, 3.0)))).ranges) == [1.0, 3.0]


def test_the_sensors_places_are_said_to_those_who_come_later(
    router_endpoint: str, bridged: Bridge, listen, until
) -> None:
    config = LidarConfig(
        source="serial:/dev/null", host="car", zenoh=ZenohConfig(namespace=SITE, connect=(router_endpoint,))
    )
    with Service("lidar", config):
        until(lambda: bridged.lines() != [])
        reader = listen("/tf_static", TF)
        until(lambda: publishers_of(reader, "/tf_static") != [])
        assert ":1:,1:,:,:,," in {one.qos for one in publishers_of(reader, "/tf_static")}
        arrived = reader.next(20.0)
        assert arrived is not None
        (transform,) = arrived.message.transforms
        assert (transform.header.frame_id, transform.child_frame_id) == ("base_link", "lidar")


def test_a_host_whose_name_begins_with_a_digit(router_endpoint: str, bridged: Bridge, until) -> None:
    config = ServiceConfig(
        source="serial:/dev/null", host="0car", zenoh=ZenohConfig(namespace=SITE, connect=(router_endpoint,))
    )
    with Service("lidar", config):
        until(lambda: [line.name for line in bridged.lines()] == ["/spotter/_0car/lidar/scan"])


def test_a_host_whose_name_is_none_in_ros_is_told(router_endpoint: str, bridged: Bridge, until) -> None:
    status = encode(Report("lidar").snapshot())
    with open_session(ZenohConfig(namespace=SITE, connect=(router_endpoint,))) as session:

        def refused() -> bool:
            session.put("a-b/lidar/status", status)
            return any("is no topic's name" in why for why in bridged.refused)

        until(refused)
    assert bridged.lines() == []


def test_from_afar_the_ros_machine_s_router_has_to_be_named() -> None:
    said = CliRunner().invoke(app, ["ros2", "--connect", "tls/10.0.0.1:7448"])
    assert said.exit_code == 2
    assert "--ros: give the ROS machine's router" in said.stderr


def test_a_message_that_ros_cannot_say_is_counted_and_the_next_one_passes(
    router_endpoint: str, bridged: Bridge, listen: Callable[[str, str], TopicReader]
) -> None:
    """ROS has seconds in 32 bits: a clock that is wrong by decades gives stamps that it has no numbers for."""
    config = LidarConfig(
        source="serial:/dev/null", host="car", zenoh=ZenohConfig(namespace=SITE, connect=(router_endpoint,))
    )
    with Service("lidar", config) as service:
        publish = service.publisher(topics.LIDAR_SCAN)
        publish(scan((1.0, 0.0)))
        reader = listen("/spotter/car/lidar/scan", LASER_SCAN)
        next_of(reader, lambda: publish(scan((1.0, 0.0))))
        late = scan((1.0, 0.0))
        late.stamp_ns = 2**63
        publish(late)
        while reader.next(0.3) is not None:
            pass
        assert next_of(reader, lambda: publish(scan((2.0, 0.0)))).ranges[0] == 2.0
    assert "car/lidar/scan: not sayable in ROS" in bridged.refused
