"""A UDP port that a sensor sends to: what is said and counted while no revolution comes of it."""

from __future__ import annotations

import queue
import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import pytest

from common.bus.status import Report
from common.clock import utc_ns
from services.infra_lidar.input import live_packets
from services.infra_lidar.input.arrivals import Arrivals
from services.infra_lidar.input.hesai_calibration import as_metadata
from services.infra_lidar.input.live_packets import (
    READ_EVERY_S,
    RECEIVE_BUFFER_BYTES,
    SHORTEST_PAUSE_S,
    Receiver,
    pause_after,
)
from services.infra_lidar.input.models import KINDS
from services.infra_lidar.input.ouster import OusterFormat
from services.infra_lidar.input.revolution import Revolution
from services.infra_lidar.input.spinning import PacketParser
from services.infra_lidar.input.velodyne import Vls128Parser
from tests.infra_lidar import ouster_packets
from tests.infra_lidar.hesai_packets import ANGLES
from tests.infra_lidar.hesai_packets import Packet as HesaiPacket
from tests.infra_lidar.made_packets import vls_packet

HERE = "127.0.0.1"
VLP16 = vls_packet(0.0, product=0x22)
OUSTER = bytes(OusterFormat(ouster_packets.metadata("LEGACY")).packet_bytes)
FITTING, UNFIT, STRANGER = "fitting", "unfit", "stranger"


@pytest.mark.parametrize(
    ("packets", "words"),
    [
        ([], "no packets on UDP port 7; check the sensor's power, cable, address"),
        ([FITTING], "UDP port 7 has packets of the sensor, but no revolution was completed; check how it turns"),
        ([FITTING, UNFIT, STRANGER], "UDP port 7 has packets of the sensor, but no revolution was completed"),
        (
            [UNFIT, UNFIT, STRANGER],
            "UDP port 7 has 2 packets of Velodyne VLP-16 at 1.2.3.4, port 7 (not supported), none of the expected kind "
            "or size; check the sensor's mode, and the metadata or calibration of `source`",
        ),
        (
            [STRANGER],
            "UDP port 7 has no packets of the sensor that is configured, but of Velodyne VLP-16 at 9.9.9.9, port 7",
        ),
    ],
)
def test_why_no_revolution_comes(packets: list[str], words: str) -> None:
    arrivals = Arrivals(7)
    for what in packets:
        if what == FITTING:
            arrivals.fitting(100.0)
        elif what == UNFIT:
            arrivals.unfit("1.2.3.4", VLP16)
        else:
            arrivals.stranger("9.9.9.9", VLP16)
    assert arrivals.why_nothing(100.1).startswith(words)
    arrivals.forget()
    assert arrivals.why_nothing(101.0).startswith("no packets on UDP port 7"), "what has stopped is not told again"


@pytest.mark.parametrize(
    ("buffer_bytes", "packet_bytes", "packets_per_s", "longest_s"),
    [
        (2 * RECEIVE_BUFFER_BYTES, 1206, 6000, READ_EVERY_S),  # as much as is asked for: the kernel says it doubled
        (2 * RECEIVE_BUFFER_BYTES, 24896, 1280, READ_EVERY_S),
        (425_984, 1206, 6000, 0.0075),  # what Linux grants when it is not configured
        (425_984, 24896, 1280, 0.0018),
        (425_984, 24896, 12_800, SHORTEST_PAUSE_S),
    ],
)
def test_a_small_buffer_of_the_kernel_is_read_more_often(
    buffer_bytes: int, packet_bytes: int, packets_per_s: int, longest_s: float
) -> None:
    pause_s = SHORTEST_PAUSE_S
    for _ in range(50):
        pause_s = pause_after(pause_s, round(pause_s * packets_per_s) * packet_bytes, buffer_bytes)
        assert SHORTEST_PAUSE_S <= pause_s <= READ_EVERY_S
    assert 0.6 * longest_s <= pause_s <= longest_s


def test_after_silence_packets_are_read_as_seldom_as_before() -> None:
    assert pause_after(SHORTEST_PAUSE_S, 0, 425_984) == READ_EVERY_S


@contextmanager
def received(parser: PacketParser, sender: str, report: Report) -> Iterator[tuple[Receiver, Callable[[bytes], None]]]:
    """A receiver that listens to ``sender``, and a function that sends to it from this machine."""
    receiver = Receiver(HERE, 0, parser, report, sender)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor:
            yield receiver, lambda packet: sensor.sendto(packet, (HERE, receiver.port)) and None
    finally:
        receiver.close()


@pytest.mark.parametrize(
    ("kind", "metadata", "packet", "model"),
    [
        ("ouster", ouster_packets.metadata("RNG15_RFL8_NIR8"), OUSTER, "Ouster with 128 beams, LEGACY"),
        ("hesai", as_metadata(ANGLES), VLP16, "Velodyne VLP-16"),
        ("velodyne", "", HesaiPacket().build(), "Hesai Pandar128E3X or OT128"),
    ],
)
def test_packets_of_the_sensor_that_do_not_fit_are_told_and_counted(
    until: Callable[..., None], kind: str, metadata: str, packet: bytes, model: str
) -> None:
    report = Report("test")
    with received(KINDS[kind].parser(metadata, 0.0), HERE, report) as (receiver, send):
        for _ in range(3):
            send(packet)
        until(lambda: report.snapshot().counters == {"packet of another kind": 3})
        assert f"has 3 packets of {model}" in receiver.why_nothing()
        assert "none of the expected kind or size" in receiver.why_nothing()


def test_strangers_that_have_stopped_are_forgotten(until: Callable[..., None]) -> None:
    report = Report("test")
    with received(Vls128Parser(), "", report) as (receiver, send):
        send(VLP16)
        until(lambda: report.snapshot().counters == {"packet of another kind": 1})
        assert "but of Velodyne VLP-16" in receiver.why_nothing()
        receiver.forget_sender()
        assert receiver.why_nothing().startswith("no packets on UDP port")


class FailingParser(Vls128Parser):
    """Its first packet raises an error that nobody has thought of."""

    def feed_all(self, packets: Sequence[bytes], stamps_ns: Sequence[int]) -> list[Revolution]:
        raise ZeroDivisionError("unthought of")


def test_an_error_in_the_receiving_thread_reaches_who_waits() -> None:
    with received(FailingParser(), "", Report("test")) as (receiver, send):
        send(vls_packet(0.0))
        with pytest.raises(ZeroDivisionError, match="unthought of"):
            any(receiver.next(0.05) for _ in range(400))  # again and again, as the source does
        with pytest.raises(ZeroDivisionError, match="unthought of"):
            receiver.next(0.0)


class HeldParser(Vls128Parser):
    """It is busy with a packet until it is released."""

    def __init__(self) -> None:
        super().__init__()
        self.stamps_ns: list[int] = []
        self.released = threading.Event()

    def feed_all(self, packets: Sequence[bytes], stamps_ns: Sequence[int]) -> list[Revolution]:
        self.stamps_ns += stamps_ns
        self.released.wait(20.0)
        return []


def test_a_packet_has_the_stamp_of_its_arrival_however_late_it_is_read(until: Callable[..., None]) -> None:
    parser, began_ns = HeldParser(), utc_ns()
    with received(parser, "", Report("test")) as (_, send):
        send(vls_packet(0.0))
        until(lambda: len(parser.stamps_ns) == 1)
        send(vls_packet(1.0, time_us=166))  # on this machine it has come when it was sent
        came_ns = utc_ns()
        parser.released.set()
        until(lambda: len(parser.stamps_ns) == 2)
    first_ns, second_ns = parser.stamps_ns
    assert began_ns <= first_ns <= second_ns <= came_ns


class TakenInBetween(queue.Queue[Revolution]):
    """The queue is full when a revolution is put into it, and empty when the oldest is to make room for it."""

    full_once = True

    def put_nowait(self, item: Revolution) -> None:
        if self.full_once:
            self.full_once = False
            raise queue.Full
        super().put_nowait(item)


def test_a_queue_that_is_emptied_meanwhile_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_packets.queue, "Queue", TakenInBetween)
    report = Report("test")
    with received(Vls128Parser(), "", report) as (receiver, send):
        for k in range(130):
            send(vls_packet(3 * k % 360, time_us=166 * k))
        assert receiver.next(20.0) is not None
    assert report.snapshot().dropped == 0
