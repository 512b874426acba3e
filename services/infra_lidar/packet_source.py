"""Packets as a source: from a capture, a ROS 2 bag, or live over UDP with a receive thread of its own.

With ``source.py`` the only file of this service that opens files and sockets, waits, or reads the clock.
"""

from __future__ import annotations

import logging
import queue
import socket
import sqlite3
import struct
import threading
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from common.clock import utc_ns
from common.config import ConfigError
from common.source_url import SourceUrl
from common.status import Report
from services.infra_lidar.blindness import FrameQuality
from services.infra_lidar.captures import CaptureError, read_pcap, read_velodyne_scan
from services.infra_lidar.ouster import MetadataError, OusterFormat, OusterParser
from services.infra_lidar.range_image import Returns, points_of
from services.infra_lidar.revolutions import Revolution
from services.infra_lidar.velodyne import PACKET_BYTES, Vls128Parser

log = logging.getLogger(__name__)

RECEIVE_BUFFER_BYTES = 8 << 20  # a fifth of a second of a 128-beam sensor
SILENCE_S = 1.0
WAITING_FRAMES = 2  # older ones are dropped: a late frame is worth less than the next
OUSTER_PORT = 7502


@dataclass(frozen=True)
class Frame:
    """returns: of one turn. received_ns: UTC when it was whole."""

    returns: Returns
    received_ns: int
    quality: FrameQuality = field(default_factory=FrameQuality)
    packets: list[bytes] = field(default_factory=list)  # what it was decoded from, if it came in packets
    metadata: str = ""  # of an Ouster

    @property
    def points(self) -> np.ndarray:
        """(N, 3..5) float32 metres, sensor frame (x, y, z, intensity, ring)."""
        return points_of(self.returns)


@dataclass(frozen=True)
class Recorded:
    """A frame of a recording; stamp_s: UTC seconds as recorded, or None."""

    returns: Returns
    stamp_s: float | None
    quality: FrameQuality = field(default_factory=FrameQuality)
    packets: list[bytes] = field(default_factory=list)
    metadata: str = ""


class PacketParser(Protocol):
    """What both sensors' parsers have in common."""

    rejected: int

    def feed(self, packet: bytes, stamp_ns: int) -> Revolution | None:
        """One packet; the revolution that ended before it, if one did."""


def recorded_revolutions(path: Path, url: SourceUrl, report: Report) -> Callable[[], Iterator[Recorded]]:
    """Revolutions of a ``.pcap`` (Velodyne, or Ouster with its metadata beside it) or ``.db3`` (Velodyne).

    Raises:
        ConfigError: another kind of file, unreadable, or an Ouster capture without metadata.
    """
    if path.suffix == ".db3":
        return lambda: _decode(_bag_packets(path), Vls128Parser(url.number("cut", 0.0)), report)
    if path.suffix != ".pcap":
        raise ConfigError(f"source {url}: {path.name} is no recording we know (.npz .pcd .bin .pcap .db3)")
    try:
        packets = [(d.stamp_ns, d.payload) for d in read_pcap(path.read_bytes())]
    except CaptureError as error:
        raise ConfigError(f"source {url}: {error}") from None
    if any(len(payload) == PACKET_BYTES for _, payload in packets):
        chosen = [p for p in packets if len(p[1]) == PACKET_BYTES]
        return lambda: _decode(iter(chosen), Vls128Parser(url.number("cut", 0.0)), report)
    layout = _read_format(Path(url.params.get("metadata", path.with_suffix(".json"))), url)
    chosen = [p for p in packets if len(p[1]) == layout.packet_bytes]  # the capture holds other services too
    return lambda: _decode(iter(chosen), OusterParser(layout), report)


def _decode(packets: Iterator[tuple[int, bytes]], parser: PacketParser, report: Report) -> Iterator[Recorded]:
    for stamp_ns, packet in packets:
        revolution = parser.feed(packet, stamp_ns)
        if revolution is not None:
            _count(revolution.quality, report)
            yield _recorded(revolution)
    report.bad_input("packet of another kind", parser.rejected)
    if isinstance(parser, OusterParser):  # its last revolution has no packet after it
        last = parser.flush()
        if last is not None:
            yield _recorded(last)


def _recorded(one: Revolution) -> Recorded:
    return Recorded(one.image, one.stamp_ns / 1e9, one.quality, one.packets, one.metadata)


def _bag_packets(path: Path) -> Iterator[tuple[int, bytes]]:
    """Packets of all VelodyneScan messages of a ROS 2 sqlite bag, in time order."""
    query = (
        "SELECT data FROM messages JOIN topics ON topics.id = topic_id "
        "WHERE type = 'velodyne_msgs/msg/VelodyneScan' ORDER BY timestamp"
    )
    try:
        with sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True) as database:
            for (message,) in database.execute(query):
                yield from read_velodyne_scan(message)
        database.close()
    except (sqlite3.Error, CaptureError) as error:
        raise ConfigError(f"{path}: {error}") from None


def _read_format(path: Path, url: SourceUrl) -> OusterFormat:
    try:
        return OusterFormat(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"source {url}: no Ouster metadata: {error}; give it with ?metadata=FILE") from None
    except MetadataError as error:
        raise ConfigError(f"source {url}: {path}: {error}") from None


def live_packets(url: SourceUrl, report: Report) -> Iterator[tuple[int, Frame]]:
    """``velodyne://:2368`` listens there; ``ouster://HOST`` asks the sensor for its metadata, then listens.

    Raises:
        ConfigError: an address that cannot be listened at, or metadata that cannot be read.
    """
    parser: PacketParser
    if url.scheme == "velodyne":
        host, _, port_text = url.target.rpartition(":")
        port, parser = _port(port_text, url), Vls128Parser(url.number("cut", 0.0))
    else:
        host, port = "", int(url.number("port", OUSTER_PORT))
        parser = OusterParser(_live_format(url))
    receiver = Receiver(host, port, parser, report)
    try:
        while True:
            revolution = receiver.next(SILENCE_S)
            if revolution is None:
                report.state("disconnected", f"no packets on UDP port {port}; check the sensor's power, cable, address")
                continue
            one = revolution
            yield one.stamp_ns, Frame(one.image, one.stamp_ns, one.quality, one.packets, one.metadata)
    finally:
        receiver.close()


def _port(text: str, url: SourceUrl) -> int:
    if not text.isdigit() or not 0 <= int(text) < 65536:
        raise ConfigError(f"source {url}: expected velodyne://[ADDRESS]:PORT")
    return int(text)


def _live_format(url: SourceUrl) -> OusterFormat:
    if "metadata" in url.params:
        return _read_format(Path(url.params["metadata"]), url)
    address = f"http://{url.target}/api/v1/sensor/metadata"
    try:
        with urllib.request.urlopen(address, timeout=5.0) as reply:
            return OusterFormat(reply.read().decode("utf-8"))
    except (urllib.error.URLError, OSError, ValueError) as error:
        raise ConfigError(f"source {url}: no metadata from {address}: {error}; give a file: ?metadata=FILE") from None


class Receiver:
    """Reads a UDP port in a thread of its own, so that the kernel's buffer never waits for the pipeline."""

    def __init__(self, host: str, port: int, parser: PacketParser, report: Report) -> None:
        self._parser = parser
        self._report = report
        self._frames: queue.Queue[Revolution] = queue.Queue(WAITING_FRAMES)
        self._stop = threading.Event()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        timeout = struct.pack("@ll", 0, 200_000)  # the kernel's: Python's asks it twice for every packet
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, timeout)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise ConfigError(f"cannot listen on UDP port {port}: {error}") from None
        self.port: int = self._socket.getsockname()[1]
        self._thread = threading.Thread(target=self._receive, name="packets", daemon=True)
        self._thread.start()

    def next(self, timeout_s: float) -> Revolution | None:
        """The next revolution, None if none came in time."""
        try:
            return self._frames.get(timeout=timeout_s)
        except queue.Empty:
            return None

    def close(self) -> None:
        """End the thread and give the port back."""
        self._stop.set()
        self._thread.join(1.0)
        self._socket.close()

    def _receive(self) -> None:
        buffer = bytearray(65536)
        dropped, rejected = 0, 0
        while not self._stop.is_set():
            try:
                length = self._socket.recv_into(buffer)
            except BlockingIOError:
                continue  # nothing came in time
            except OSError:
                return  # closed
            revolution = self._parser.feed(bytes(memoryview(buffer)[:length]), utc_ns())
            if self._parser.rejected > rejected:
                self._report.bad_input("packet of another kind", self._parser.rejected - rejected)
                rejected = self._parser.rejected
            if revolution is None:
                continue
            _count(revolution.quality, self._report)
            revolution = replace(revolution, quality=replace(revolution.quality, dropped_frames=dropped))
            dropped = self._offer(revolution)

    def _offer(self, revolution: Revolution) -> int:
        """Queue it; the oldest waiting frame makes room. Returns how many were dropped."""
        try:
            self._frames.put_nowait(revolution)
            return 0
        except queue.Full:
            self._frames.get_nowait()
            self._report.dropped()
            self._frames.put_nowait(revolution)
            return 1


def _count(quality: FrameQuality, report: Report) -> None:
    report.bad_input("packet lost", quality.packets_lost)
    report.bad_input("incomplete revolution", int(not quality.complete))
