"""ROS bags as a source: clouds, or a sensor's packets for our own decoders. Opens files; needs the extra ``ros2``.

The library ``rosbags`` reads ROS 2 (sqlite3 and MCAP; a file, or the folder with its ``metadata.yaml``) and ROS 1.
Packets are found by their shape, whatever the driver's package is called: a message has ``packets`` with ``data``
(Velodyne, Hesai, RoboSense, Nebula drivers) or is one packet in ``buf`` (Ouster). ``sensors.model_of`` tells the
sensor.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from services.infra_lidar.input.pcd import FrameError
from services.infra_lidar.input.pointcloud2 import points_of_message
from services.infra_lidar.input.sensors import OUSTER, model_of

CLOUD = "sensor_msgs/msg/PointCloud2"
SUFFIXES = (".db3", ".mcap", ".bag")
NEEDS_EXTRA = "a bag needs the extra `ros2`, which is not installed: uv pip install -c constraints.txt '.[ros2]'"
_PACKETS = (
    "/msg/VelodyneScan", "/msg/PacketMsg", "/msg/NebulaPackets", "/msg/PandarScan", "/msg/UdpFrame", "/msg/RslidarScan",
    "/msg/RslidarPacket", "/msg/RobosenseScan",
)  # fmt: skip
_SMALLEST_BYTES = 500  # of a packet of ranges; those of an inertial unit are smaller
_LOOKED_AT = 200  # messages of a topic in which packets are looked for


class BagError(ValueError):
    """A bag that cannot be read; the text says why."""


@dataclass(frozen=True)
class BagTopic:
    """A topic with clouds or packets. model: of the sensor whose packets it holds; "" = clouds, or nothing known."""

    name: str
    type: str
    messages: int
    model: str = ""

    def __str__(self) -> str:
        return f"{self.name} ({self.model or self.type})"


def is_bag(path: Path) -> bool:
    """Whether the name is a bag's: a file with such a suffix, or a folder with the bag's metadata."""
    return (path / "metadata.yaml").exists() if path.is_dir() else path.suffix.lower() in SUFFIXES


class Bag:
    """An open bag; ``open_bag`` opens it."""

    def __init__(self, reader: Any) -> None:
        self._reader = reader
        self.all_topics = sorted({(one.topic, one.msgtype) for one in reader.connections})

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """(UTC ns at which it was recorded, message) in this order.

        Raises:
            BagError: damaged, or no such topic, or of a type that nobody defines.
        """
        connections = [one for one in self._reader.connections if one.topic == topic]
        if not connections:  # the library would take all
            raise BagError(f"no topic {topic}")
        with _damage():
            for connection, stamp_ns, data in self._reader.messages(connections=connections):
                yield stamp_ns, self._reader.deserialize(data, connection.msgtype)

    def topics(self) -> list[BagTopic]:
        """Those with clouds, and those with packets, whose sensor is known or not.

        Raises:
            BagError: damaged.
        """
        found = []
        for name, kind in self.all_topics:
            count = sum(one.msgcount for one in self._reader.connections if one.topic == name)
            if kind == CLOUD:
                found.append(BagTopic(name, kind, count))
            elif kind.endswith(_PACKETS):
                found.append(BagTopic(name, kind, count, self._model(name)))
        return found

    def ouster_metadata(self) -> str:
        """The metadata that the Ouster driver publishes beside its packets; "" if they are not in the bag."""
        strings = [name for name, kind in self.all_topics if kind == "std_msgs/msg/String"]
        texts = [message.data for name in strings for _, message in islice(self.messages(name), 1)]
        return next((text for text in texts if "beam_altitude_angles" in text), "")

    def _model(self, topic: str) -> str:
        """The sensor of the first packet that is known; an Ouster's may be of a kind that only its metadata tell."""
        ouster = ""
        for stamp_ns, message in islice(self.messages(topic), _LOOKED_AT):
            for _, packet in packets_of(message, stamp_ns):
                if model := model_of(packet):
                    return model
                ouster = OUSTER if hasattr(message, "buf") and len(packet) >= _SMALLEST_BYTES else ouster
        return ouster


def packets_of(message: Any, recorded_ns: int) -> Iterator[tuple[int, bytes]]:
    """(UTC ns, packet) of a driver's message: the packet's own stamp, or that of the recording where it has none.

    Raises:
        BagError: it is defined in the bag, and has none of the shapes above.
    """
    with _damage():
        for one in message.packets if hasattr(message, "packets") else [message]:  # a scan may be empty
            data = one.buf if hasattr(one, "buf") else one.data
            stamp_ns = _ns(one.stamp) if hasattr(one, "stamp") else 0
            yield stamp_ns or recorded_ns, np.asarray(data, np.uint8).tobytes()[: getattr(one, "size", None)]


def points_in(message: Any, recorded_ns: int) -> tuple[int, np.ndarray]:
    """UTC ns, of the recording where the cloud has none, and (N, 3..5) float32 points of a PointCloud2.

    Raises:
        FrameError: not as ROS defines it, or what ``points_of_message`` refuses.
    """
    try:
        return _ns(message.header.stamp) or recorded_ns, points_of_message(message)
    except AttributeError as error:
        raise FrameError(f"the bag defines another PointCloud2 than ROS ({error})") from None


def _ns(stamp: Any) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """The bag while it is open.

    Raises:
        BagError: no bag, damaged, of a name that the library does not read, or the extra is not installed.
    """
    if path.suffix not in SUFFIXES and path.suffix.lower() in SUFFIXES:
        raise BagError(f"a bag's name has to end in {path.suffix.lower()}, found {path.suffix}: rename it")
    try:
        from rosbags.highlevel import AnyReader

        from common.ros2.types import type_store
    except ImportError:
        raise BagError(NEEDS_EXTRA) from None
    with ExitStack() as stack:
        with _damage():
            reader = stack.enter_context(AnyReader([path], default_typestore=type_store()))
        yield Bag(reader)


@contextmanager
def _damage() -> Iterator[None]:
    """Turn what the library raises on damaged bytes into a ``BagError`` of one sentence."""
    try:
        yield
    except _library_errors() as error:
        what = str(error).strip().split("\n")[0]
        raise BagError(f"no ROS bag, or a damaged one ({what or type(error).__name__})") from None


@cache
def _library_errors() -> tuple[type[Exception], ...]:
    import apsw
    from rosbags import rosbag1, rosbag2
    from rosbags.highlevel.anyreader import AnyReaderError
    from rosbags.serde import SerdeError
    from rosbags.typesys import TypesysError

    documented = (AnyReaderError, rosbag1.ReaderError, rosbag2.ReaderError, SerdeError, TypesysError, apsw.Error)
    seen = (struct.error, OSError, ValueError, LookupError, AssertionError, EOFError, RuntimeError, MemoryError)
    return *documented, *seen, OverflowError, TypeError, AttributeError  # the latter with bags damaged at random
