"""``ros2:/points?type=sensor_msgs/msg/PointCloud2``: frames from a ROS 2 driver. Opens a session and reads the clock.

The driver's clouds, or its sensor's packets, which go through our own decoders. What packets do not say comes from the
files that a live sensor's source names too: ``?metadata=FILE`` of an Ouster, ``?calibration=FILE`` of a Hesai. The own
driver of RoboSense publishes the DIFOP packets, which hold the angles, among the others.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from common.bus.status import Report
from common.config import ConfigError, ZenohConfig
from common.ros2.reader import Arrived, TopicReader
from common.ros2.source import RosTopic, ros_session, ros_topic
from common.source_url import SourceUrl
from services.infra_lidar.input import robosense
from services.infra_lidar.input.bags import CLOUD, BagError, packets_of
from services.infra_lidar.input.calibration_files import read_hesai, read_ouster, read_robosense
from services.infra_lidar.input.hesai_calibration import CalibrationError
from services.infra_lidar.input.models import KINDS
from services.infra_lidar.input.packets import Frame, ParserCounts, count_losses, frame_of
from services.infra_lidar.input.pcd import FrameError
from services.infra_lidar.input.pointcloud2 import points_of_message
from services.infra_lidar.input.revolution import Revolution
from services.infra_lidar.input.sensors import model_of
from services.infra_lidar.input.spinning import PacketParser

VELODYNE, OUSTER = "velodyne_msgs/msg/VelodyneScan", "ouster_sensor_msgs/msg/PacketMsg"
NEBULA, RSLIDAR = "nebula_msgs/msg/NebulaPackets", "rslidar_msg/msg/RslidarPacket"
KIND_OF_TYPE = {  # as in ``models.KINDS``; "" = of several, ?sensor= says which
    VELODYNE: "velodyne",
    OUSTER: "ouster",
    "hesai_ros_driver/msg/UdpFrame": "hesai",
    "pandar_msgs/msg/PandarScan": "hesai",
    RSLIDAR: "robosense",
    "robosense_msgs/msg/RobosenseScan": "robosense",
    NEBULA: "",
}
TYPES = (CLOUD, *KIND_OF_TYPE)
ONE_A_MESSAGE = (OUSTER, RSLIDAR)
NODE = "spotter_infra_lidar"
WAITING_PACKETS = 4096  # two revolutions: one packet a message
STEP_NS = 1_000_000_000  # a packet's own stamp farther from its message's is of another clock, or missing


def ros_frames(url: SourceUrl, zenoh: ZenohConfig, report: Report) -> Iterator[tuple[int, Frame]]:
    """Frames with the UTC ns of their measurement, as they come.

    Raises:
        ConfigError: a wrong address, or packets without what they do not say themselves.
    """
    topic, session = ros_topic(url, TYPES), ros_session(url, zenoh)
    if topic.type == CLOUD:
        return _clouds(TopicReader(topic, session, report, NODE))
    kind = _kind(url, topic)
    packets = Packets(kind, _metadata(url, kind, topic), url.number("cut", 0.0), ParserCounts(report))
    waiting = WAITING_PACKETS if topic.type in ONE_A_MESSAGE else 2
    return _revolutions(TopicReader(topic, session, report, NODE, waiting), packets, report)


def _kind(url: SourceUrl, topic: RosTopic) -> str:
    kind = KIND_OF_TYPE[topic.type] or url.params.get("sensor", "")
    if kind not in KINDS:
        raise ConfigError(f"source {url}: {topic.type} is of several sensors: give ?sensor={'|'.join(KINDS)}")
    return kind


def _metadata(url: SourceUrl, kind: str, topic: RosTopic) -> str | None:
    """What the packets need; None = it comes among them."""
    if kind == "ouster":
        if "metadata" not in url.params:
            raise ConfigError(f"source {url}: packets of an Ouster need its metadata: ?metadata=FILE")
        return read_ouster(Path(url.params["metadata"]), url)
    if kind == "hesai":
        return read_hesai(url, None)
    if kind == "robosense" and "calibration" in url.params:
        return read_robosense(url, Path(url.params["calibration"]))
    if kind == "robosense" and topic.type != RSLIDAR:
        raise ConfigError(f"source {url}: {topic.type} holds no DIFOP packets: give the angles with ?calibration=FILE")
    return None if kind == "robosense" else ""


class PacketError(ValueError):
    """A packet that cannot be used; the text says why."""


class Packets:
    """The packets of a topic on their way to the parser; it is made when what it needs is there.

    metadata: None = the angles come in a DIFOP packet. counts: told what the parser counts.
    """

    def __init__(self, kind: str, metadata: str | None, cut_deg: float, counts: ParserCounts) -> None:
        self._kind, self._cut_deg, self._counts = kind, cut_deg, counts
        self._parser: PacketParser | None = None if metadata is None else KINDS[kind].parser(metadata, cut_deg)

    def feed(self, dated: list[tuple[int, bytes]]) -> tuple[list[Revolution], list[str]]:
        """Packets with their UTC ns; the revolutions that ended, and why packets could not be used, for each of them.

        That is because they are of another sensor, or the angles are damaged or have not come yet.
        """
        usable, wrong = [], []
        for stamp_ns, packet in dated:
            try:
                if self._is_measured(packet):
                    usable.append((stamp_ns, packet))
            except PacketError as error:
                wrong.append(str(error))
        if self._parser is None:
            return [], wrong
        before = self._parser.rejected
        revolutions = self._parser.feed_all([packet for _, packet in usable], [stamp_ns for stamp_ns, _ in usable])
        self._counts.update(self._parser)
        if self._parser.rejected > before:
            models = [model_of(packet) for _, packet in usable if not self._parser.accepts(packet)]
            wrong += [
                f"packets of {model or 'an unknown sensor'}, expected those of a supported {self._kind} sensor"
                for model in models
            ]
        return revolutions, wrong

    def _is_measured(self, packet: bytes) -> bool:
        """Whether it goes to the parser; a DIFOP packet makes the parser instead.

        Raises:
            PacketError: damaged angles, or no angles yet.
        """
        if self._kind == "robosense" and robosense.is_difop(packet):
            if self._parser is None:
                self._take_angles(packet)
            return False
        if self._parser is None:
            raise PacketError("no DIFOP packet with the beam angles has come yet; ?calibration=FILE gives them")
        return True

    def _take_angles(self, packet: bytes) -> None:
        try:
            metadata = robosense.as_metadata(robosense.read_difop(packet))
            self._parser = KINDS[self._kind].parser(metadata, self._cut_deg)
        except CalibrationError as error:
            raise PacketError(f"DIFOP packet: {error}") from None


def _clouds(reader: TopicReader) -> Iterator[tuple[int, Frame]]:
    with reader:
        for arrived in reader.messages():
            try:
                points = points_of_message(arrived.message)
            except FrameError as error:
                reader.refuse(str(error), "unreadable cloud")
                continue
            yield arrived.stamp_ns, Frame(points, arrived.received_ns)


def _revolutions(reader: TopicReader, packets: Packets, report: Report) -> Iterator[tuple[int, Frame]]:
    with reader:
        for arrived in reader.messages():
            try:
                dated = dated_packets(arrived, reader.topic)
            except BagError as error:
                reader.refuse(str(error), "unusable packet")
                continue
            for revolution in _of_message(dated, reader, packets, report):
                count_losses(revolution.quality, report)
                yield revolution.stamp_ns, frame_of(revolution)


def _of_message(
    dated: list[tuple[int, bytes]], reader: TopicReader, packets: Packets, report: Report
) -> Iterator[Revolution]:
    """The revolutions that end in a message. One that holds no packet that can be used is refused, with why."""
    revolutions, wrong = packets.feed(dated)
    report.bad_input("unusable packet", len(wrong))
    yield from revolutions
    if wrong and len(wrong) == len(dated):
        reader.refuse(wrong[-1])


def dated_packets(arrived: Arrived, topic: RosTopic) -> list[tuple[int, bytes]]:
    """(UTC ns, packet) of a message. A packet is dated by its own stamp where that is of the message's clock.

    Raises:
        BagError: it holds none.
    """
    believed = topic.stamp == "header"
    return [
        (own_ns if believed and abs(own_ns - arrived.stamp_ns) < STEP_NS else arrived.stamp_ns, packet)
        for own_ns, packet in packets_of(arrived.message, arrived.stamp_ns)
    ]
