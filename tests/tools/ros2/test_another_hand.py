"""Both directions against zenoh-ros2-sdk in a process of its own, through a router with access rules."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from common import topics
from common.bus.runtime import Service
from common.bus.session import build, close_session, open_session
from common.bus.status import Report
from common.clock import utc_ns
from common.config import ServiceConfig, ZenohConfig
from common.host.site import HostConfig, Ros2Config, ServicePlace, Site
from common.messages import ObjectTrack, ObjectTracks
from common.ros2.node import Node
from common.ros2.reader import TopicReader
from common.ros2.source import RosTopic
from common.security import authority
from common.security.router_config import router_config
from services.infra_lidar.input.pointcloud2 import points_of_message
from spotter_tools.ros2.bridge import Bridge
from spotter_tools.ros2.table import ROWS
from spotter_tools.ros2.tracked_objects import TRACKED_OBJECTS

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(
        importlib.util.find_spec("zenoh_ros2_sdk") is None, reason="zenoh-ros2-sdk (extra dev) is not installed"
    ),
]
PEER = Path(__file__).parents[3] / "examples" / "ros2_peer.py"
CLOUD = "sensor_msgs/msg/PointCloud2"
Peer = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ros2") / "keys"
    authority.init(folder, "spotter")
    authority.issue(folder, "infra0", "host", ("127.0.0.1",))
    return folder


@pytest.fixture
def guarded(keys: Path, free_ports: Callable[[], int]) -> Iterator[Callable[..., ZenohConfig]]:
    """A router with rules that lets through these ROS domains; the way to it from its own host."""
    opened = []

    def router_with(*domains: int) -> ZenohConfig:
        host = HostConfig(local_port=free_ports(), port=free_ports(), services={"infra_lidar": ServicePlace()})
        site = Site(hosts={"infra0": host}, ros2=Ros2Config(domains=domains))
        opened.append(zenoh.open(build(router_config(site, "infra0", keys))))
        return ZenohConfig(namespace=site.namespace, connect=(host.loopback,))

    yield router_with
    for router in opened:
        close_session(router)


@pytest.fixture
def peer() -> Iterator[Peer]:
    """``peer(config, "points")``: the program of another hand, at the same router."""
    started: list[subprocess.Popen[str]] = []

    def start(config: ZenohConfig, *words: str) -> subprocess.Popen[str]:
        router = config.connect[0].removeprefix("tcp/")
        command = [sys.executable, "-W", "ignore", str(PEER), *words, "--router", router]
        started.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()


def reader_of(config: ZenohConfig) -> TopicReader:
    without = ZenohConfig(namespace="", connect=config.connect)
    return TopicReader(RosTopic("/points", CLOUD), without, Report("infra_lidar"), "us")


def test_their_clouds_are_read_here(guarded, peer: Peer, until) -> None:
    config = guarded(0)
    peer(config, "points", "--columns", "90", "--seconds", "60")
    with reader_of(config) as reader:
        clouds: list[Any] = []
        until(lambda: clouds.append(reader.next(1.0)) or clouds[-1] is not None, budget_s=60.0)
        points = points_of_message(clouds[-1].message)
        assert points.shape[1] == 5
        assert len(points) > 1000
        assert {int(ring) for ring in points[:, 4]} <= set(range(128))
        (one,) = reader.graph.publishers()
        assert (one.full_node, one.topic, one.type_) == ("/street", "/points", CLOUD)


def test_without_the_domain_in_the_site_s_rules_nothing_of_ros_passes(guarded, peer: Peer, until) -> None:
    """Domain 7 is let through, theirs is 0: the other traffic of the same router shows that it works."""
    config = guarded(7)
    process = peer(config, "points", "--columns", "90", "--seconds", "60")
    with reader_of(config) as reader, open_session(ZenohConfig(namespace="", connect=config.connect)) as ros:
        allowed = RosTopic("/scan", "sensor_msgs/msg/LaserScan", 7)
        with TopicReader(allowed, ZenohConfig(namespace="", connect=config.connect), Report("x"), "us") as other:
            node = Node(ros, "driver", 7)
            node.announce("MP", "/scan", allowed.type, ROWS[0].qos)
            until(lambda: other.graph.publishers() != [])
        assert reader.next(1.5) is None
        assert process.poll() is None
        assert "do its rules let ROS through?" in reader.why_nothing()


def car(number: int) -> ObjectTrack:
    return ObjectTrack(
        track_id=number, label="car", label_confidence=0.9, position_m=(10.0, 2.0, 0.8), velocity_mps=(8.25, 0.0, 0.0),
        covariance=[[0.0] * 6] * 6, size_m=(4.5, 1.8, 1.5), yaw_rad=0.0, age_s=3.0, score=0.8, state="confirmed",
        points=99,
    )  # fmt: skip


def test_our_tracks_are_read_there(guarded, peer: Peer, until) -> None:
    config = guarded(0)
    ours, ros = open_session(config), open_session(ZenohConfig(namespace="", connect=config.connect))
    bridge, stop = Bridge(ours, Node(ros, "spotter"), ROWS, sensors=False), threading.Event()
    worker = threading.Thread(target=bridge.run, args=(stop,))
    worker.start()
    live = ServiceConfig(host="infra0", source="velodyne://:2368", zenoh=config)
    with Service("infra_lidar", live) as service:
        publish = service.publisher(topics.INFRA_TRACKS)
        until(lambda: len(bridge.lines()) >= 3)
        process = peer(
            config, "listen", "/spotter/infra0/infra_lidar/objects", TRACKED_OBJECTS, "--count", "1", "--seconds", "60"
        )

        def publish_and_poll() -> bool:
            publish(ObjectTracks(stamp_ns=utc_ns(), tracks=[car(7)]))
            return process.poll() is not None

        until(publish_and_poll, budget_s=60.0)
    stop.set()
    worker.join()
    bridge.close()
    for session in (ours, ros):
        close_session(session)
    assert process.returncode == 0
    assert process.stdout is not None
    words = process.stdout.read()
    assert "frame_id='map'" in words
    assert "label=1" in words
