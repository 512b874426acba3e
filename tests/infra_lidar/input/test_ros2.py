"""Clouds and packets of a ROS 2 driver as a source, over a real router."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh

from common.bus.session import open_session
from common.bus.status import Report
from common.clock import utc_ns
from common.config import ConfigError, ZenohConfig
from common.ros2.keys import SENSOR_DATA
from common.ros2.node import Node, RosPublisher
from common.ros2.types import build, header, time_of
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.ouster import OusterFormat
from services.infra_lidar.input.packets import Frame
from services.infra_lidar.input.ros2 import CLOUD, NEBULA, OUSTER, RSLIDAR, VELODYNE
from services.infra_lidar.input.source import open_source
from tests.infra_lidar.hesai_packets import ANGLES
from tests.infra_lidar.hesai_packets import Packet as HesaiPacket
from tests.infra_lidar.made_packets import metadata, ouster_packet, vls_packet
from tests.infra_lidar.robosense_packets import Msop, difop


@pytest.fixture
def ros(router_endpoint: str) -> Iterator[zenoh.Session]:
    with open_session(ZenohConfig(namespace="", connect=(router_endpoint,))) as session:
        yield session


class Opened:
    """A source, its report, and its frames as they are asked for in a thread of their own."""

    def __init__(self, source: str, endpoint: str) -> None:
        import threading

        self.report, self.frames = Report("infra_lidar"), list[tuple[int, Frame]]()
        config = InfraLidarConfig(source=source, zenoh=ZenohConfig(namespace="site", connect=(endpoint,)))
        frames = open_source(config, self.report)
        threading.Thread(target=lambda: self.frames.extend(frames), daemon=True).start()

    def reason(self) -> str:
        return self.report.snapshot().reason


def cloud(points: np.ndarray, stamp_ns: int, fields: str = "xyz") -> Any:
    made = [
        build("sensor_msgs/msg/PointField", name=n, offset=4 * k, datatype=7, count=1) for k, n in enumerate(fields)
    ]
    step = 4 * len(fields)
    return build(
        CLOUD, header=header(stamp_ns, "pole"), height=1, width=len(points), fields=made, point_step=step,
        row_step=step * len(points), data=np.frombuffer(points.astype("<f4").tobytes(), np.uint8), is_dense=True,
    )  # fmt: skip


def connected(until: Callable[..., None], publisher: RosPublisher) -> RosPublisher:
    until(lambda: publisher.wanted)
    return publisher


def test_clouds_become_frames_and_a_wrong_one_is_told(router_endpoint, ros, until) -> None:
    opened = Opened("ros2:/points", router_endpoint)
    publish = connected(until, Node(ros, "driver").publisher("/points", CLOUD, SENSOR_DATA))
    points = np.arange(30.0).reshape(10, 3)
    stamp_ns = utc_ns()
    publish(cloud(points, stamp_ns))
    until(lambda: opened.frames)
    stamped_ns, frame = opened.frames[0]
    assert stamped_ns == stamp_ns
    np.testing.assert_array_equal(frame.points, points)

    def wrong_is_told() -> bool:
        publish(cloud(points, utc_ns(), fields="xyr"))
        return "no field z among x y r" in opened.reason()

    until(wrong_is_told)
    assert opened.report.snapshot().state == "disconnected"
    publish(cloud(points, utc_ns()))
    until(lambda: len(opened.frames) > 1, "it comes back by itself")


def test_velodyne_packets_go_through_our_decoder(router_endpoint, ros, until) -> None:
    opened = Opened(f"ros2:/velodyne_packets?type={VELODYNE}", router_endpoint)
    publish = connected(until, Node(ros, "driver").publisher("/velodyne_packets", VELODYNE, SENSOR_DATA))
    begin_ns = utc_ns()
    packets = [
        build("velodyne_msgs/msg/VelodynePacket", stamp=time_of(begin_ns + 166_000 * k),
              data=np.frombuffer(vls_packet(0.6 * k % 360, time_us=166 * k), np.uint8))
        for k in range(610)
    ]  # fmt: skip
    publish(build(VELODYNE, header=header(begin_ns, "velodyne"), packets=packets))
    until(lambda: opened.frames)
    stamp_ns, frame = opened.frames[0]
    assert frame.quality.complete
    assert len(frame.packets) >= 599
    assert begin_ns < stamp_ns <= begin_ns + 610 * 166_000

    def of_another_sensor() -> bool:
        other = build("velodyne_msgs/msg/VelodynePacket", data=np.frombuffer(vls_packet(0, product=0x22), np.uint8))
        publish(build(VELODYNE, header=header(utc_ns(), "velodyne"), packets=[other]))
        return "expected those of a supported velodyne sensor" in opened.reason()

    until(of_another_sensor)


def test_ouster_packets_need_metadata_and_are_dated_by_arrival(router_endpoint, ros, until, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"need its metadata: \?metadata=FILE"):
        Opened(f"ros2:/ouster/lidar_packets?type={OUSTER}", router_endpoint)
    (tmp_path / "m.json").write_text(metadata())
    opened = Opened(f"ros2:/ouster/lidar_packets?type={OUSTER}&metadata={tmp_path}/m.json", router_endpoint)
    publish = connected(until, Node(ros, "driver").publisher("/ouster/lidar_packets", OUSTER, SENSOR_DATA))
    begin_ns, layout = utc_ns(), OusterFormat(metadata())
    for frame_id in (1, 2, 3):
        for column in range(0, 64, 16):
            publish(build(OUSTER, buf=np.frombuffer(ouster_packet(layout, frame_id, column), np.uint8)))
    until(lambda: len(opened.frames) >= 2)
    stamps = [stamp_ns for stamp_ns, _ in opened.frames]
    assert begin_ns < stamps[0]
    assert all(a <= b for a, b in pairwise(stamps))
    assert len(opened.frames[0][1].points) == 64 * 4


HESAI = [
    HesaiPacket(sequence=k, azimuth=(600 * k % 36000, (600 * k + 20) % 36000), checks=False).build() for k in range(121)
]
RUBY = [
    Msop(plus=True, azimuth=(60 * k % 36000, (60 * k + 20) % 36000, (60 * k + 40) % 36000), microsecond=166 * k).build()
    for k in range(1205)
]


def as_message(kind: str, packets: list[bytes]) -> Any:
    """A driver's message of these packets; fixed arrays are filled up, as the drivers do."""
    package, _, name = kind.split("/")
    inner = {"UdpFrame": "UdpPacket", "PandarScan": "PandarPacket", "NebulaPackets": "NebulaPacket"}[name]
    of_message = []
    for packet in packets:
        data = packet.ljust(1500, b"\0") if inner == "PandarPacket" else packet
        size = {} if inner == "NebulaPacket" else {"size": len(packet)}
        of_message.append(build(f"{package}/msg/{inner}", data=np.frombuffer(data, np.uint8), **size))
    return build(kind, header=header(utc_ns(), "hesai"), packets=of_message)


@pytest.mark.parametrize(
    ("kind", "query"),
    [("hesai_ros_driver/msg/UdpFrame", ""), ("pandar_msgs/msg/PandarScan", ""), (NEBULA, "&sensor=hesai")],
)
def test_hesai_packets_of_three_drivers(router_endpoint, ros, until, tmp_path: Path, kind: str, query: str) -> None:
    (tmp_path / "angles.csv").write_text(ANGLES)
    opened = Opened(f"ros2:/packets?type={kind}&calibration={tmp_path}/angles.csv{query}", router_endpoint)
    publish = connected(until, Node(ros, "driver").publisher("/packets", kind, SENSOR_DATA))
    publish(as_message(kind, HESAI))
    until(lambda: opened.frames)
    stamp_ns, frame = opened.frames[0]
    assert (frame.kind, len(frame.packets)) == ("hesai", 60)
    assert abs(utc_ns() - stamp_ns) < 60 * 10**9, "a packet without a stamp has its message's"


def test_a_packet_that_cannot_be_used_costs_no_other_of_its_message(
    router_endpoint, ros, until, tmp_path: Path
) -> None:
    (tmp_path / "angles.csv").write_text(ANGLES)
    opened = Opened(f"ros2:/packets?type={NEBULA}&calibration={tmp_path}/angles.csv&sensor=hesai", router_endpoint)
    publish = connected(until, Node(ros, "driver").publisher("/packets", NEBULA, SENSOR_DATA))
    publish(as_message(NEBULA, [*HESAI[:3], b"nonsense", *HESAI[3:]]))
    until(lambda: opened.frames)
    assert len(opened.frames[0][1].packets) == 60
    until(lambda: opened.report.snapshot().counters.get("unusable packet") == 1)
    assert opened.report.snapshot().state != "disconnected"


def hesai_with(third: HesaiPacket | None = None) -> list[bytes]:
    """Packets with check sums that are right; ``third`` comes in place of the third."""
    plain = [HesaiPacket(sequence=k, azimuth=(600 * k, 600 * k + 20)) for k in range(4)]
    return [packet.build() for packet in [*plain[:2], third or plain[2], plain[3]]]


DAMAGED = hesai_with()
DAMAGED[2] = DAMAGED[2][:100] + b"?" + DAMAGED[2][101:]


@pytest.mark.parametrize(
    ("packets", "counted"),
    [
        ([*hesai_with(), hesai_with()[3]], {"packet doubled": 1}),
        ([HESAI[0], HESAI[2], HESAI[1]], {"packet late": 1}),
        (DAMAGED, {"packet damaged": 1}),
        (hesai_with(HesaiPacket(sequence=2, azimuth=(1200, 1220), safety_state=6)), {"sensor reports shutdown": 1}),
    ],
)
def test_what_the_parser_counts_is_in_the_status(
    router_endpoint, ros, until, tmp_path: Path, packets: list[bytes], counted: dict[str, int]
) -> None:
    """Without a revolution that has ended."""
    (tmp_path / "angles.csv").write_text(ANGLES)
    opened = Opened(f"ros2:/packets?type={NEBULA}&calibration={tmp_path}/angles.csv&sensor=hesai", router_endpoint)
    publish = connected(until, Node(ros, "driver").publisher("/packets", NEBULA, SENSOR_DATA))
    publish(as_message(NEBULA, packets))
    until(lambda: counted.items() <= opened.report.snapshot().counters.items())


def test_robosense_packets_wait_for_the_angles_that_come_among_them(router_endpoint, ros, until) -> None:
    opened = Opened(f"ros2:/rslidar_packets?type={RSLIDAR}", router_endpoint)
    publish = connected(until, Node(ros, "driver").publisher("/rslidar_packets", RSLIDAR, SENSOR_DATA))

    def send(packet: bytes) -> None:
        publish(build(RSLIDAR, header=header(utc_ns(), "rslidar"), data=np.frombuffer(packet, np.uint8)))

    def angles_are_missed() -> bool:
        send(RUBY[0])
        return "no DIFOP packet with the beam angles has come yet" in opened.reason()

    until(angles_are_missed)
    send(difop())
    for packet in RUBY:
        send(packet)
    until(lambda: opened.frames)
    assert opened.frames[0][1].kind == "robosense"


@pytest.mark.parametrize(
    ("source", "words"),
    [
        (f"ros2:/p?type={NEBULA}", r"is of several sensors: give \?sensor=velodyne\|ouster\|hesai\|robosense"),
        ("ros2:/p?type=pandar_msgs/PandarScan", r"Hesai packets hold no beam angles"),
        (
            "ros2:/p?type=robosense_msgs/RobosenseScan",
            r"holds no DIFOP packets: give the angles with \?calibration=FILE",
        ),
        ("ros2:/points?type=sensor_msgs/msg/LaserScan", "type sensor_msgs/msg/LaserScan is not read here"),
        ("ros2:/points?port=1", "no parameter 'port' for ros2:"),
    ],
)
def test_a_wrong_address_stops_before_anything_starts(source: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        open_source(InfraLidarConfig(source=source), Report("infra_lidar"))
