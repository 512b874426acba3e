"""`spotter-infra-lidar look FILE_OR_PORT`: what it says of captures and ports."""

from __future__ import annotations

import re
import socket
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from common.bus.status import Report
from common.config import ConfigError
from common.source_url import parse_source
from services.infra_lidar.input.captures import Datagram
from services.infra_lidar.input.live_packets import Receiver, live_packets
from services.infra_lidar.input.ouster import OusterFormat
from services.infra_lidar.input.senders import describe, listen, print_senders
from services.infra_lidar.input.sensors import returns_of
from services.infra_lidar.input.source import SCHEMES
from services.infra_lidar.input.velodyne import Vls128Parser
from tests.infra_lidar.hesai_packets import Packet as HesaiPacket
from tests.infra_lidar.made_packets import vls_packet
from tests.infra_lidar.ouster_packets import metadata
from tests.infra_lidar.robosense_packets import Msop


def sent(packets: list[bytes], sender: str = "192.168.1.201", port: int = 2368) -> list[Datagram]:
    return [Datagram(166_000 * k, sender, port, packet) for k, packet in enumerate(packets)]


def turns(count: int) -> list[bytes]:
    return [vls_packet((0.6 * k) % 360, time_us=166 * k) for k in range(600 * count + 1)]


def test_a_sensor_in_a_capture_with_rate_returns_and_source() -> None:
    packets = turns(3)
    del packets[700:710]
    lines = list(describe(sent(packets), Path("street.pcap")))
    assert (
        lines[0] == "Velodyne VLS-128 at 192.168.1.201, port 2368: 6027 packets a second of 1206 bytes, single return"
    )
    assert "10.1 revolutions per second" in lines[1]
    assert "packets lost 10, doubled 0, late 0" in lines[1]
    assert lines[2].strip() == 'source = "file:street.pcap?from=192.168.1.201&port=2368"'


def ouster_bytes(profile: str) -> int:
    """The size of a packet of 128 beams, which is all that `look` knows of the profile."""
    return OusterFormat(metadata(profile)).packet_bytes


@pytest.mark.parametrize(
    ("packet", "returns"),
    [
        (vls_packet(0.0, mode=0x37), "single return"),
        (vls_packet(0.0, mode=0x38), "single return"),
        (vls_packet(0.0, mode=0x39), "dual return"),
        (HesaiPacket(mode=0x33).build(), "single return"),
        (HesaiPacket(mode=0x3B).build(), "dual return"),
        (HesaiPacket(qt128=True, mode=0x38).build(), "single return"),
        (HesaiPacket(qt128=True, mode=0x39).build(), "dual return"),
        (Msop(azimuth=(100, 120, 140)).build(), "single return"),
        (Msop(azimuth=(100, 120, 120), dual=True).build(), "dual return"),
        (Msop(plus=True, azimuth=(100, 100, 120), dual=True).build(), "dual return"),
        (bytes(ouster_bytes("RNG19_RFL8_SIG16_NIR16")), "single return"),
        (bytes(ouster_bytes("RNG19_RFL8_SIG16_NIR16_RGB16_DUAL")), "dual return"),
        (bytes(ouster_bytes("RNG15_RFL8_NIR8_DUAL")), ""),  # one size with RNG15_RFL8_NIR8_ZONE16
        (vls_packet(0.0, product=0x22), ""),
        (b"x" * 1206, ""),
    ],
)
def test_whether_one_or_two_returns_are_sent(packet: bytes, returns: str) -> None:
    assert returns_of(packet) == returns


def test_several_sensors_and_what_is_not_supported() -> None:
    velarray = sent([vls_packet(0.0, product=0x22)] * 5, "192.168.1.7")
    lines = list(describe([*sent(turns(2)), *velarray], None))
    assert any(line.strip() == 'source = "velodyne://:2368?from=192.168.1.201"' for line in lines)
    assert any("Velodyne VLP-16 at 192.168.1.7, port 2368 (not supported)" in line for line in lines)


def test_nothing_that_we_know() -> None:
    assert list(describe(sent([b"x"] * 7), None)) == ["no packets of a lidar that we know among 7 datagrams"]
    assert list(describe([], None)) == ["no packets of a lidar that we know"]


def test_a_port_is_listened_to(free_ports: Callable[[], int]) -> None:
    free_port = free_ports()
    stop = threading.Event()

    def speak() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not stop.wait(0.01):
                sender.sendto(vls_packet(0.0), ("127.0.0.1", free_port))

    thread = threading.Thread(target=speak)
    thread.start()
    try:
        datagram = next(listen(free_port, 20.0))
    finally:
        stop.set()
        thread.join()
    assert (datagram.sender, datagram.port) == ("127.0.0.1", free_port)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("", free_port))
        with pytest.raises(ConfigError, match="cannot listen on UDP port"):
            next(listen(free_port, 0.2))


@pytest.mark.parametrize("where", ["0", ":65536", "99999", "99999999999"])
def test_a_port_out_of_range_is_refused_in_a_sentence(where: str) -> None:
    with pytest.raises(ConfigError, match="UDP port: expected a port from 1 to 65535, found '"):
        print_senders(where, 0.1)


def test_a_foreign_sensor_on_the_port_is_named(until) -> None:  # type: ignore[no-untyped-def]
    report = Report("test")
    receiver = Receiver("127.0.0.1", 0, Vls128Parser(), report)
    try:
        assert receiver.why_nothing().startswith("no packets on UDP port")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(vls_packet(0.0, product=0x22), ("127.0.0.1", receiver.port))
            until(lambda: report.snapshot().counters.get("packet of another kind") == 1)
        assert "but of Velodyne VLP-16 at 127.0.0.1" in receiver.why_nothing()
    finally:
        receiver.close()


def test_only_the_configured_sender_is_listened_to(until) -> None:  # type: ignore[no-untyped-def]
    report = Report("test")
    receiver = Receiver("", 0, Vls128Parser(), report, sender="127.0.0.2")
    try:
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as right,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wrong,
        ):
            right.bind(("127.0.0.2", 0))
            wrong.bind(("127.0.0.3", 0))
            for k in range(0, 130):
                for sender in (right, wrong):
                    packet = vls_packet((3 * k) % 360, time_us=166 * k + (sender is wrong))
                    sender.sendto(packet, ("127.0.0.1", receiver.port))
            revolution = receiver.next(20.0)
        assert revolution is not None
        assert len(revolution.packets) <= 121
        until(lambda: report.snapshot().counters.get("packet of another sensor") == 130)
    finally:
        receiver.close()


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("ouster://os?metadata=M&group=10.0.0.1", "group=10.0.0.1: expected a multicast address"),
        ("hesai://239.1.2.3?calibration=C", "239.1.2.3 is a multicast group: hesai://SENSOR?group=239.1.2.3"),
        ("robosense://239.1.2.3", "239.1.2.3 is a multicast group: robosense://SENSOR?group=239.1.2.3"),
    ],
)
def test_what_is_no_group_and_what_is_no_sensor_is_refused(source: str, said: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(said)):
        live_packets(parse_source(source, SCHEMES), Report("test"))


def test_the_receiver_gets_the_group_of_the_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Opened(Exception):
        """Instead of a socket."""

    def opened(host: str, port: int, *_: object) -> None:
        raise Opened(host, port)

    monkeypatch.setattr("services.infra_lidar.input.live_packets.Receiver", opened)
    (tmp_path / "os.json").write_text(metadata("LEGACY"), encoding="utf-8")
    source = f"ouster://127.0.0.1?metadata={tmp_path / 'os.json'}&group=239.255.12.34"
    with pytest.raises(Opened) as raised:
        next(live_packets(parse_source(source, SCHEMES), Report("test")))
    assert raised.value.args == ("239.255.12.34", 7502)


def test_a_multicast_group_is_joined(until) -> None:  # type: ignore[no-untyped-def]
    report = Report("test")
    receiver = Receiver("239.255.12.34", 0, Vls128Parser(), report)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
            try:
                sender.sendto(b"a stranger", ("239.255.12.34", receiver.port))
            except OSError as error:
                pytest.skip(f"no way to a multicast group here: {error}")
            until(lambda: report.snapshot().counters.get("packet of another kind") == 1)
    finally:
        receiver.close()


@pytest.mark.parametrize("step_ns", [0, -1])
def test_stamps_that_do_not_run_tell_no_rate(step_ns: int) -> None:
    packets = [Datagram(step_ns * k, "192.168.1.201", 2368, packet) for k, packet in enumerate(turns(2))]
    lines = list(describe(packets, Path("street.pcap")))
    assert ": 1201 packets of 1206 bytes, single return" in lines[0]
    assert "the last stamp is not after the first: the stamps do not tell a rate" in lines[1]
    assert "a second" not in "".join(lines)
    assert "per second" not in "".join(lines)


def test_a_folder_without_frames_says_what_it_holds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "street.pcap").write_bytes(b"")
    assert not print_senders(str(tmp_path), 1.0)
    assert capsys.readouterr().out.strip().endswith(f"in {tmp_path}; it holds street.pcap")
