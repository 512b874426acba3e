"""Sensors that need a calibration, from a capture or a port to points: it is found, asked for, or they are refused."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from common.bus.status import Report
from common.config import ConfigError
from common.source_url import parse_source
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input import calibration_files
from services.infra_lidar.input.calibration_files import asked_metadata
from services.infra_lidar.input.captures import Datagram
from services.infra_lidar.input.hesai_calibration import as_metadata
from services.infra_lidar.input.hesai_commands import ask_calibration
from services.infra_lidar.input.models import KINDS, decoder_of, kind_of
from services.infra_lidar.input.revolution import decode_revolution, stack_packets
from services.infra_lidar.input.robosense import as_metadata as as_angles
from services.infra_lidar.input.robosense import read_difop
from services.infra_lidar.input.senders import describe
from services.infra_lidar.input.source import SCHEMES, open_source
from tests.infra_lidar.hesai_packets import ANGLES, OT128_FIRETIMES, QT128_FIRETIMES, Packet
from tests.infra_lidar.robosense_packets import HORIZONTAL_DEG, VERTICAL_DEG, Msop, difop

TURNS = [Packet(sequence=k, azimuth=(600 * k % 36000, (600 * k + 20) % 36000)).build() for k in range(121)]


def pcap(packets: list[bytes], first: tuple[bytes, int] | None = None, port: int = 2368) -> bytes:
    """A capture of packets to one port, after one to another port."""
    data = struct.pack("<IHHIIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 101)  # raw IP
    sent = [(packet, port) for packet in packets]
    for k, (packet, port) in enumerate([first, *sent] if first else sent):
        head = struct.pack(
            ">BBHHHBBH4s4s", 0x45, 0, 28 + len(packet), 1, 0, 64, 17, 0, b"\xc0\xa8\x01\xc9", b"\xff" * 4
        )
        frame = head + struct.pack(">HHHH", 10000, port, 8 + len(packet), 0) + packet
        stamp_us = round(1e5 / 60 * k)
        data += struct.pack("<IIII", 100 + stamp_us // 1_000_000, stamp_us % 1_000_000, len(frame), len(frame)) + frame
    return data


@pytest.fixture
def street(tmp_path: Path) -> Path:
    """A capture of two turns of a Pandar128 or OT128."""
    path = tmp_path / "street.pcap"
    path.write_bytes(pcap(TURNS))
    return path


def frames(url: str) -> list:
    return [frame for _, frame in open_source(InfraLidarConfig(source=url), Report("test"))]


def test_a_hesai_capture_with_its_calibration(street: Path) -> None:
    (street.parent / "angles.csv").write_text(ANGLES)
    (street.parent / "times.csv").write_text(OT128_FIRETIMES)
    found = frames(f"file:{street}?rate=0&calibration={street.parent}/angles.csv&firetimes={street.parent}/times.csv")
    assert [len(frame.packets) for frame in found] == [60, 60]
    assert {frame.kind for frame in found} == {"hesai"}
    assert np.allclose(np.linalg.norm(found[0].points[:, :3], axis=1), 10.0, atol=1e-3)
    again = decode_revolution(stack_packets(found[0].packets), decoder_of("hesai", found[0].metadata))
    np.testing.assert_array_equal(again.points, found[0].points)


def test_a_calibration_beside_the_capture_is_taken(street: Path) -> None:
    street.with_suffix(".csv").write_text(ANGLES)
    assert len(frames(f"file:{street}?rate=0")) == 2


@pytest.mark.parametrize(
    ("capture", "beside"),
    [
        ("street.pcap", "street.csv"),
        ("street.pcap.gz", "street.csv"),
        ("street.PCAP.GZ", "street.csv"),
        ("site.2024-05-01.pcap", "site.2024-05-01.csv"),
        ("site.2024-05-01.pcapng.gz", "site.2024-05-01.csv"),
        ("street", "street.csv"),
    ],
)
def test_the_file_beside_a_capture_has_its_name(capture: str, beside: str) -> None:
    assert calibration_files.beside(Path("folder") / capture, ".csv") == Path("folder") / beside


@pytest.mark.parametrize(
    ("angles", "query", "words"),
    [
        (None, "", "give the sensor's own angle correction file with ?calibration=FILE"),
        (None, "&calibration=none.csv", "none.csv: "),
        ("1,2,3\n", "", "street.csv: angles: expected a row for each of 128 channels, found 1"),
        (ANGLES, "&firetimes=none.csv", "none.csv: "),
    ],
)
def test_without_a_calibration_there_are_no_points(street: Path, angles: str | None, query: str, words: str) -> None:
    if angles is not None:
        street.with_suffix(".csv").write_text(angles)
    with pytest.raises(ConfigError) as raised:
        frames(f"file:{street}?rate=0{query}")
    assert words in str(raised.value)


def test_firing_times_of_another_model_are_refused(street: Path) -> None:
    street.with_suffix(".csv").write_text(ANGLES)
    (street.parent / "qt.csv").write_text(QT128_FIRETIMES)
    with pytest.raises(
        ConfigError, match=r"qt\.csv: firing times of Hesai QT128, packets of Hesai Pandar128E3X or OT128"
    ):
        frames(f"file:{street}?rate=0&firetimes={street.parent}/qt.csv")


def test_look_tells_the_model_its_figures_and_what_to_write() -> None:
    sent = [Datagram(round(1e8 / 60) * k, "192.168.1.201", 2368, packet) for k, packet in enumerate(TURNS)]
    lines = list(describe([*sent[:50], *sent[51:]], Path("street.pcap")))
    who = "Hesai Pandar128E3X or OT128 at 192.168.1.201, port 2368"
    assert lines[0] == f"{who}: 600 packets a second of 839 bytes, single return"
    assert "15232 returns per revolution; packets lost 1, doubled 0, late 0" in lines[1]
    assert lines[2].strip() == ('source = "file:street.pcap?from=192.168.1.201&port=2368&calibration=ANGLES.csv"')
    assert 'source = "hesai://192.168.1.201?port=2368"' in " ".join(describe(sent, None))


RUBY_TURNS = [
    Msop(
        plus=True, azimuth=((600 * k) % 36000, (600 * k + 20) % 36000, (600 * k + 40) % 36000), microsecond=167 * k
    ).build()
    for k in range(121)
]
NO_DIFOP = "no DIFOP packet, which holds the beam angles"


def test_a_robosense_capture_with_its_difop_packets(tmp_path: Path) -> None:
    path = tmp_path / "ruby.pcap"
    path.write_bytes(pcap(RUBY_TURNS, (difop(), 7788), port=6699))
    found = frames(f"file:{path}?rate=0")
    assert [len(frame.packets) for frame in found] == [60, 60]
    assert np.allclose(np.linalg.norm(found[0].points[:, :3], axis=1), 10.0, atol=0.03)
    again = decode_revolution(stack_packets(found[0].packets), decoder_of("robosense", found[0].metadata))
    np.testing.assert_array_equal(again.points, found[0].points)


def test_a_robosense_capture_without_angles(tmp_path: Path) -> None:
    path = tmp_path / "ruby.pcap"
    path.write_bytes(pcap(RUBY_TURNS, port=6699))
    with pytest.raises(ConfigError, match=NO_DIFOP):
        frames(f"file:{path}?rate=0")
    lines = list(describe([Datagram(k, "10.0.0.9", 6699, packet) for k, packet in enumerate(RUBY_TURNS)], path))
    assert lines[0].startswith("RoboSense Ruby Plus at 10.0.0.9, port 6699: ")
    assert "returns per revolution; packets lost 0" in lines[1]
    assert lines[2].strip() == f'source = "file:{path}?from=10.0.0.9&port=6699&calibration=ANGLES.csv"'
    assert "record the DIFOP port too" in lines[3]
    path.with_suffix(".csv").write_text(
        "".join(f"{v},{h}\n" for v, h in zip(VERTICAL_DEG, HORIZONTAL_DEG, strict=True))
    )
    assert len(frames(f"file:{path}?rate=0")) == 2


def test_the_angles_are_heard_on_the_difop_port(free_ports: Callable[[], int]) -> None:
    port, ended = free_ports(), threading.Event()

    def speak() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not ended.wait(0.01):
                sender.sendto(RUBY_TURNS[0], ("127.0.0.1", port))
                sender.sendto(difop(), ("127.0.0.1", port))

    thread = threading.Thread(target=speak, daemon=True)
    thread.start()
    url = parse_source(f"robosense://127.0.0.1?difop={port}", SCHEMES)
    assert asked_metadata(url) == as_angles(read_difop(difop()))
    ended.set()
    thread.join()


def test_a_port_without_difop_packets_is_said(free_ports: Callable[[], int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibration_files, "DIFOP_WAIT_S", 0.05)
    with pytest.raises(ConfigError, match=NO_DIFOP):
        asked_metadata(parse_source(f"robosense://127.0.0.1?difop={free_ports()}", SCHEMES))


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("velodyne://:notaport", "expected a port from 1 to 65535, found 'notaport'"),
        ("velodyne://:2368?cut=north", "cut='north' is not a number"),
        ("hesai://h?calibration=/nope.csv", "/nope.csv: "),
        ("hesai://h?firetimes=/nope.csv", "/nope.csv: "),
        ("hesai://h?firetimes={binary}", "binary: .*can't decode"),
        ("hesai://h?port=0", "port: expected a port from 1 to 65535, found '0'"),
        ("ouster://h?metadata=/nope", "no Ouster metadata: .*/nope"),
        ("ouster://h?metadata={binary}", "binary: .*can't decode"),
        ("robosense://h?calibration=/nope.csv", "/nope.csv: "),
        ("robosense://h?difop=70000", "difop: expected a port from 1 to 65535, found '70000'"),
    ],
)
def test_a_wrong_live_source_stops_before_a_frame_is_asked_for(tmp_path: Path, source: str, words: str) -> None:
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match=words):
        open_source(InfraLidarConfig(source=source.format(binary=tmp_path / "binary")), Report("test"))


@pytest.mark.parametrize("source", ["velodyne://:2368", "ouster://no.such", "hesai://no.such", "robosense://no.such"])
def test_the_network_is_not_needed_before_a_frame_is_asked_for(source: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_network(*_: object) -> None:
        raise AssertionError("the network was used")

    monkeypatch.setattr(socket, "socket", no_network)
    monkeypatch.setattr(socket, "gethostbyname", no_network)
    open_source(InfraLidarConfig(source=source), Report("test"))


@pytest.fixture
def command_port() -> Iterator[tuple[int, dict[int, bytes]]]:
    """A sensor's command port that answers commands with what is in the dictionary, others with return code 1."""
    answers: dict[int, bytes] = {}
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            with connection:
                while len(request := connection.recv(8)) == 8:
                    start, command, _, length = struct.unpack(">2sBBI", request)
                    assert (start, length) == (b"\x47\x74", 0)
                    body = answers.get(command, b"")
                    connection.sendall(struct.pack(">2sBBI", start, command, 0 if body else 1, len(body)) + body)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    yield listener.getsockname()[1], answers
    listener.shutdown(socket.SHUT_RDWR)
    listener.close()
    thread.join(2.0)


def test_the_sensor_is_asked_for_its_calibration(command_port: tuple[int, dict[int, bytes]]) -> None:
    port, answers = command_port
    answers[0x05] = ANGLES.encode() + b"\0"
    assert ask_calibration("127.0.0.1", port) == as_metadata(ANGLES.strip("\0"))
    answers[0xA9] = QT128_FIRETIMES.encode()
    assert ask_calibration("127.0.0.1", port) == as_metadata(ANGLES, QT128_FIRETIMES)


def test_a_sensor_that_does_not_tell_is_refused(command_port: tuple[int, dict[int, bytes]]) -> None:
    with pytest.raises(ValueError, match="refuses"):
        ask_calibration("127.0.0.1", command_port[0])


def test_every_kind_is_found_by_its_models() -> None:
    for name, kind in KINDS.items():
        assert {kind_of(model) for model in kind.models} == {name}
    with pytest.raises(KeyError, match="expected a sensor of velodyne"):
        kind_of("Livox")


def test_firing_times_of_a_file_go_with_the_angles_that_the_sensor_tells(
    command_port: tuple[int, dict[int, bytes]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    port, answers = command_port
    answers[0x05] = ANGLES.encode()
    (tmp_path / "times.csv").write_text(OT128_FIRETIMES)
    monkeypatch.setattr(calibration_files, "ask_calibration", lambda host: ask_calibration(host, port))
    url = parse_source(f"hesai://127.0.0.1?firetimes={tmp_path}/times.csv", SCHEMES)
    assert asked_metadata(url) == as_metadata(ANGLES, OT128_FIRETIMES)


@pytest.mark.parametrize("answer", [b"SSH-2.0-sensor\r\n", b"", b"HTTP/1.1 200 OK\r\nContent-Length: 9\r\n\r\n{}"])
def test_an_ouster_that_answers_with_no_http_is_refused_in_words(answer: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve() -> None:
            connection, _ = listener.accept()
            with connection:
                connection.recv(4096)
                connection.sendall(answer)

        thread = threading.Thread(target=serve)
        thread.start()
        url = parse_source(f"ouster://127.0.0.1:{listener.getsockname()[1]}", SCHEMES)
        with pytest.raises(ConfigError, match=r"no whole HTTP answer \(.*\); give a file: \?metadata=FILE"):
            asked_metadata(url)
        thread.join()
