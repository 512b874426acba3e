"""ROS bags as sources, written by rosbags itself: clouds, packets of drivers of several names, and what is refused."""

from __future__ import annotations

import contextlib
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from common.bus.status import Report
from common.config import ConfigError
from common.recording.file import RecordingFile
from common.ros2.types import build, header, time_of, to_cdr, type_store
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.bags import BagError, open_bag, packets_of
from services.infra_lidar.input.ouster import OusterFormat
from services.infra_lidar.input.packets import Frame
from services.infra_lidar.input.senders import print_senders
from services.infra_lidar.input.source import open_source
from tests.infra_lidar.made_packets import metadata, ouster_packet, vls_packet
from tests.infra_lidar.robosense_packets import Msop, difop

START_NS = 1_700_000_000_000_000_000
ROWS = np.array([[1.0, 2.0, 3.0, 40.0, 5.0], [-1.0, 0.5, 0.25, 255.0, 127.0]], np.float32)
STORAGES = [StoragePlugin.SQLITE3, StoragePlugin.MCAP]
Message = tuple[str, str, int, Any]  # topic, type, UTC ns, message


def cloud(stamp_ns: int, rows: np.ndarray = ROWS) -> Any:
    fields = [
        build("sensor_msgs/msg/PointField", name=name, offset=4 * k, datatype=7, count=1)
        for k, name in enumerate(("x", "y", "z", "intensity", "ring"))
    ]
    return build(
        "sensor_msgs/msg/PointCloud2", header=header(stamp_ns, "lidar"), height=1, width=len(rows), fields=fields,
        is_bigendian=False, point_step=20, row_step=20 * len(rows), data=np.frombuffer(rows.tobytes(), np.uint8),
        is_dense=True,
    )  # fmt: skip


def clouds(count: int = 3, topic: str = "/points") -> list[Message]:
    stamps = [START_NS + 100_000_000 * k for k in range(count)]
    return [(topic, "sensor_msgs/msg/PointCloud2", ns, cloud(ns, ROWS + k)) for k, ns in enumerate(stamps)]


def scans(turns: int = 2, dated: bool = True, product: int = 0xA1) -> list[Message]:
    """VelodyneScan messages of 100 packets."""
    packets = [vls_packet((0.6 * k) % 360, time_us=166 * k, product=product) for k in range(600 * turns + 5)]
    found = []
    for first in range(0, len(packets), 100):
        stamp_ns = START_NS + 166_000 * first
        of_message = [
            build(
                "velodyne_msgs/msg/VelodynePacket", stamp=time_of(stamp_ns if dated else 0), data=np.frombuffer(p, "u1")
            )
            for p in packets[first : first + 100]
        ]
        scan = build("velodyne_msgs/msg/VelodyneScan", header=header(stamp_ns, "velodyne"), packets=of_message)
        found.append(("/velodyne_packets", "velodyne_msgs/msg/VelodyneScan", stamp_ns, scan))
    return found


def ouster(with_metadata: bool = True) -> list[Message]:
    layout_text = metadata()
    layout = OusterFormat(layout_text)
    text = build("std_msgs/msg/String", data=layout_text)
    found: list[Message] = [("/ouster/metadata", "std_msgs/msg/String", START_NS, text)] if with_metadata else []
    for k in range(12):
        packet = ouster_packet(layout, k // 4, 16 * (k % 4))
        message = build("ouster_sensor_msgs/msg/PacketMsg", buf=np.frombuffer(packet, np.uint8))
        found.append(("/ouster/lidar_packets", "ouster_sensor_msgs/msg/PacketMsg", START_NS + k * 25_000_000, message))
    return found


def write(path: Path, messages: list[Message], storage: StoragePlugin = StoragePlugin.MCAP) -> Path:
    """A bag of the library's own writer: a folder with metadata.yaml."""
    with Writer(path, version=9, storage_plugin=storage) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, stamp_ns, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=type_store())
            writer.write(connections[topic], stamp_ns, to_cdr(message))
    return path


def frames(path: Path, query: str = "", report: Report | None = None) -> list[Frame]:
    url = f"file:{path}?rate=0{query}"
    return [frame for _, frame in open_source(InfraLidarConfig(source=url), report or Report("test"))]


@pytest.mark.parametrize("storage", STORAGES, ids=lambda storage: storage.name)
@pytest.mark.parametrize("alone", [False, True], ids=["folder", "file alone"])
def test_clouds_of_a_bag(tmp_path: Path, storage: StoragePlugin, alone: bool) -> None:
    folder = write(tmp_path / "bag", clouds(), storage)
    path = next(one for one in folder.iterdir() if one.suffix in (".db3", ".mcap")) if alone else folder
    got = [frame.points for frame in frames(path)]
    assert [points[0, 0] for points in got] == [1.0, 2.0, 3.0]
    np.testing.assert_array_equal(got[0], ROWS)


@pytest.mark.parametrize("storage", STORAGES, ids=lambda storage: storage.name)
def test_packets_of_a_velodyne_go_through_our_decoder(tmp_path: Path, storage: StoragePlugin) -> None:
    got = frames(write(tmp_path / "bag", scans(), storage))
    assert [frame.quality.complete for frame in got] == [True, True]
    assert [frame.quality.packets_lost for frame in got] == [0, 0]
    assert len(got[0].points) == 600 * 12 * 32


def test_packets_without_a_stamp_have_that_of_the_recording(tmp_path: Path) -> None:
    with open_bag(write(tmp_path / "bag", scans(1, dated=False))) as bag:
        recorded_ns, message = next(bag.messages("/velodyne_packets"))
        assert {stamp_ns for stamp_ns, _ in packets_of(message, recorded_ns)} == {START_NS}


def test_an_ouster_with_its_metadata_in_the_bag_or_beside_it(tmp_path: Path) -> None:
    got = frames(write(tmp_path / "with", ouster()))
    assert [frame.quality.complete for frame in got] == [True, True, True]
    without = write(tmp_path / "without", ouster(with_metadata=False))
    with pytest.raises(ConfigError, match="no Ouster metadata"):
        frames(without)
    (tmp_path / "sensor.json").write_text(metadata())
    assert len(frames(without, f"&metadata={tmp_path / 'sensor.json'}")) == 3


@pytest.mark.parametrize("name", ["PandarScan", "UdpFrame", "NebulaPackets", "RslidarScan", "RobosenseScan"])
def test_a_driver_whose_package_has_another_name(tmp_path: Path, name: str) -> None:
    """The bag defines the type; the shape of the message is what counts. Its packets are longer than what was sent."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(
        get_types_from_msg("builtin_interfaces/Time stamp\nuint8[1500] data\nuint32 size\n", "my/msg/Packet")
    )
    store.register(get_types_from_msg("std_msgs/Header header\nmy/Packet[] packets\n", f"my/msg/{name}"))
    packet_type, scan_type = store.types["my/msg/Packet"], store.types[f"my/msg/{name}"]
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/packets", f"my/msg/{name}", typestore=store)
        for first in range(0, 605, 55):
            packets = []
            for k in range(first, first + 55):
                data = np.frombuffer(vls_packet((0.6 * k) % 360, time_us=166 * k).ljust(1500, b"\7"), np.uint8)
                packets.append(packet_type(stamp=time_of(START_NS + k), data=data, size=1206))
            scan = scan_type(header=header(START_NS, "lidar"), packets=packets)
            writer.write(connection, START_NS + first, store.serialize_cdr(scan, f"my/msg/{name}"))
    (frame,) = frames(tmp_path / "bag")
    assert frame.quality.complete


@pytest.mark.parametrize("difop_packets", [0, 1])
def test_a_robosense_with_its_angles_in_the_bag(tmp_path: Path, difop_packets: int) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    text = "std_msgs/Header header\nuint8 is_difop\nuint8 is_frame_begin\nuint8[] data\n"
    store.register(get_types_from_msg(text, "rslidar_msg/msg/RslidarPacket"))
    packet_type = store.types["rslidar_msg/msg/RslidarPacket"]
    turn = [Msop(azimuth=(60 * k, 60 * k + 20, 60 * k + 40), microsecond=166 * k).build() for k in range(600)]
    packets = [difop()] * difop_packets + turn + turn[:3]
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/rslidar_packets", "rslidar_msg/msg/RslidarPacket", typestore=store)
        for k, packet in enumerate(packets):
            message = packet_type(header(START_NS + k, "lidar"), 0, 0, np.frombuffer(packet, np.uint8))
            writer.write(connection, START_NS + k, store.serialize_cdr(message, "rslidar_msg/msg/RslidarPacket"))
    if not difop_packets:
        with pytest.raises(ConfigError, match="no DIFOP packet in the bag: give the angles with"):
            frames(tmp_path / "bag")
        return
    report = Report("test")
    (frame,) = frames(tmp_path / "bag", report=report)
    assert frame.quality.complete
    assert report.snapshot().counters == {}


def test_a_bag_of_ros_1(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    header_type, cloud_type = store.types["std_msgs/msg/Header"], store.types["sensor_msgs/msg/PointCloud2"]
    made = cloud(START_NS)
    with Writer1(tmp_path / "old.bag") as writer:
        connection = writer.add_connection("/points", "sensor_msgs/msg/PointCloud2", typestore=store)
        field = store.types["sensor_msgs/msg/PointField"]
        fields = [field(one.name, one.offset, one.datatype, one.count) for one in made.fields]
        old = cloud_type(header_type(0, made.header.stamp, "lidar"), 1, 2, fields, False, 20, 40, made.data, True)
        writer.write(connection, START_NS, store.serialize_ros1(old, "sensor_msgs/msg/PointCloud2"))
    (frame,) = frames(tmp_path / "old.bag")
    np.testing.assert_array_equal(frame.points, ROWS)


@pytest.mark.parametrize(
    ("messages", "words"),
    [
        ([*clouds(), *clouds(topic="/other")], r"several topics: /other .*; /points .*Choose one with \?topic="),
        ([*clouds(), *scans(1)], r"several topics: /points .*; /velodyne_packets \(Velodyne VLS-128\)"),
        ([("/tf", "std_msgs/msg/String", 1, build("std_msgs/msg/String", data="x"))], r"in the bag: /tf \(std_msgs"),
        (
            scans(1, product=0x22),
            r"no packets of a sensor that is supported \(.*\); in the bag: /velodyne_packets \(Velodyne VLP-16\)",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_chosen_is_named(tmp_path: Path, messages: list[Message], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        frames(write(tmp_path / "bag", messages))


def test_a_topic_is_chosen_by_name(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", [*clouds(), *scans(1)])
    assert len(frames(path, "&topic=/points")) == 3
    assert len(frames(path, "&topic=/velodyne_packets")) == 1
    with pytest.raises(ConfigError, match="in the bag"):
        frames(path, "&topic=/nowhere")


def test_a_cloud_that_contradicts_itself_is_counted_and_left_out(tmp_path: Path) -> None:
    messages = clouds()
    messages[1][3].width = 9
    report = Report("test")
    assert len(frames(write(tmp_path / "bag", messages), report=report)) == 2
    assert report.snapshot().counters == {"unreadable cloud": 1}


@pytest.mark.parametrize("suffix", [".db3", ".mcap", ".bag"])
@pytest.mark.parametrize(
    "data", [b"", b"garbage" * 20, b"SQLite format 3\0" + bytes(200), b"\x89MCAP0\r\n" + bytes(50)]
)
def test_what_is_no_bag_is_refused(tmp_path: Path, suffix: str, data: bytes) -> None:
    (tmp_path / f"x{suffix}").write_bytes(data)
    with pytest.raises(ConfigError, match="no ROS bag, or a damaged one"):
        frames(tmp_path / f"x{suffix}")


def test_our_own_recording_is_told_from_a_bag(tmp_path: Path) -> None:
    with RecordingFile(tmp_path / "ours.mcap", {"spotter": {"version": "test"}}):
        pass
    with pytest.raises(ConfigError, match="what `spotter record` wrote is read as mcap:"):
        frames(tmp_path / "ours.mcap")


def test_without_the_extra_it_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "x.db3").write_bytes(b"")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(ConfigError, match="extra `ros2`"):
        frames(tmp_path / "x.db3")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], bytes]:
    """The bytes of a small bag of each storage."""
    folder = tmp_path_factory.mktemp("bags")
    bags = {one.name: write(folder / one.name, clouds(2), one) for one in STORAGES}
    found = {
        name: next(one for one in bag.iterdir() if one.suffix in (".db3", ".mcap")).read_bytes()
        for name, bag in bags.items()
    }
    return lambda name: found[name]


@settings(max_examples=40, deadline=None)
@given(storage=st.sampled_from([one.name for one in STORAGES]), share=st.floats(0, 1), wrong=st.binary(max_size=40))
def test_a_damaged_bag_is_refused_or_gives_what_can_be_read(
    whole: Callable[[str], bytes], tmp_path_factory: pytest.TempPathFactory, storage: str, share: float, wrong: bytes
) -> None:
    data = whole(storage)
    at = int(share * len(data))
    folder = tmp_path_factory.mktemp("damaged")
    for number, damaged in enumerate((data[:at], data[:at] + wrong + data[at + len(wrong) :])):
        path = folder / f"{number}{'.db3' if storage == 'SQLITE3' else '.mcap'}"
        path.write_bytes(damaged)
        with contextlib.suppress(ConfigError):
            assert len(frames(path)) <= 2
    shutil.rmtree(folder)


def test_look_says_what_is_in_a_bag_and_how_to_read_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "bag", [*clouds(), *scans(1)])
    assert print_senders(str(path), 1.0)
    output = capsys.readouterr().out
    assert "/points (sensor_msgs/msg/PointCloud2): 3 messages of 2 points, 10.0 a second" in output
    assert "/velodyne_packets (velodyne_msgs/msg/VelodyneScan), Velodyne VLS-128: 7 messages of 100 packets" in output
    assert f'source = "file:{path}?topic=/velodyne_packets"' in output
    nothing = write(tmp_path / "tf", [("/tf", "std_msgs/msg/String", 1, build("std_msgs/msg/String", data="x"))])
    assert not print_senders(str(nothing), 1.0)
    assert "no clouds and no packets of a lidar that we know; in the bag: /tf" in capsys.readouterr().out
    (tmp_path / "x.bag").write_bytes(b"x")
    with pytest.raises(ConfigError, match="no ROS bag"):
        print_senders(str(tmp_path / "x.bag"), 1.0)


def test_a_topic_that_is_not_there(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", clouds(1))
    with open_bag(path) as bag, pytest.raises(BagError, match="no topic /nowhere"):
        next(bag.messages("/nowhere"))
