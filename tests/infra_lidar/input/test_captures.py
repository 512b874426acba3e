"""Captures of every container and link layer, of sensors that are supported and others, and of several at once."""

from __future__ import annotations

import gzip
import io
import struct
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import pytest

from common.bus.status import Report
from common.config import ConfigError
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.captures import read_capture
from services.infra_lidar.input.sensors import model_of
from services.infra_lidar.input.source import open_source
from tests.infra_lidar.made_captures import COOKED, COOKED2, cooked, ethernet, ipv4, ipv6, pcap, pcapng, udp
from tests.infra_lidar.made_packets import metadata, vls_packet

FIRST = ethernet(ipv4(b"first"))


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("pcap", pcap(FIRST)),
        ("big endian", pcap(FIRST, order=">")),
        ("nanoseconds", pcap(FIRST, nanoseconds=True)),
        ("gzip", gzip.compress(pcap(FIRST), mtime=0)),
        ("pcapng", pcapng(FIRST)),
        ("pcapng big endian", pcapng(FIRST, order=">")),
        ("VLAN", pcap(ethernet(ipv4(b"first"), (0x8100,)))),
        ("QinQ", pcap(ethernet(ipv4(b"first"), (0x88A8, 0x8100)))),
        ("Linux cooked", pcap(cooked(ipv4(b"first")), link=COOKED)),
        ("VLAN on cooked", pcap(cooked(ipv4(b"first"), (0x8100,)), link=COOKED)),
        ("cooked v2", pcap(struct.pack(">H", 0x0800) + bytes(18) + ipv4(b"first"), link=COOKED2)),
        ("raw IP", pcap(ipv4(b"first"), link=101)),
        ("IPv6", pcap(ethernet(ipv6(udp(b"first"))))),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_the_payload_is_found_behind_every_container_and_link_layer(name: str, data: bytes) -> None:
    (datagram,) = read_capture(io.BytesIO(data))
    assert (datagram.payload, datagram.port) == (b"first", 2368), name
    assert abs(datagram.stamp_ns - 100_000_005_000) < 10_000
    assert datagram.sender == ("::1" if name == "IPv6" else "192.168.1.201")


@pytest.mark.parametrize(
    "data",
    [pcap(FIRST, FIRST), pcapng(FIRST, FIRST), gzip.compress(pcap(FIRST, FIRST), mtime=0)],
    ids=["pcap", "pcapng", "gzip"],
)
def test_a_capture_that_is_cut_gives_what_is_whole(data: bytes) -> None:
    assert len(list(read_capture(io.BytesIO(data[:-9])))) <= 2
    assert next(iter(read_capture(io.BytesIO(data[: 9 * len(data) // 10])))).payload == b"first"


class Endless(io.RawIOBase):
    """A capture that never ends; ``given`` counts the bytes that were taken of it."""

    def __init__(self, beginning: bytes, record: bytes) -> None:
        self._beginning, self._record, self._at, self.given = beginning, record, 0, 0

    def read(self, size: int = -1) -> bytes:
        assert size >= 0, "read to its end"
        stop, data = self._at + size, b""
        while len(data) < size:
            at = self._at + len(data)
            whole, start = (self._beginning, 0) if at < len(self._beginning) else (self._record, len(self._beginning))
            data += whole[(at - start) % len(whole) :][: stop - at]
        self._at, self.given = stop, self.given + size
        return data

    def seek(self, offset: int, whence: int = 0) -> int:
        assert whence == 0
        self._at = offset
        return offset

    def tell(self) -> int:
        return self._at


@pytest.mark.parametrize("make", [pcap, pcapng], ids=["pcap", "pcapng"])
def test_a_capture_is_read_no_farther_than_it_is_taken(make: Callable[..., bytes]) -> None:
    """So that memory does not grow with the file: of a capture without an end the first datagrams come at once."""
    head, record = make(), make(FIRST)[len(make()) :]
    stream = Endless(head, record)
    taken = [datagram.payload for datagram in islice(read_capture(stream), 1000)]  # type: ignore[arg-type]
    assert taken == [b"first"] * 1000
    assert stream.given < len(head) + 1100 * len(record)


# --- which sensor ---

HESAI = bytes([0xEE, 0xFF, 1, 3, 0, 0, 128, 2]) + bytes(853)
RUBY = b"\x55\xaa\x05\x5a" + bytes(1244)  # the head of a Ruby, no block of it


def test_sensors_are_known_by_their_packets() -> None:
    assert model_of(vls_packet(0.0)) == "Velodyne VLS-128"
    assert model_of(vls_packet(0.0, product=0x22)) == "Velodyne VLP-16"
    assert model_of(HESAI) == "Hesai with 128 beams, protocol 1.3"
    assert model_of(RUBY).startswith("RoboSense")
    assert model_of(bytes(24832)) == "Ouster with 128 beams, RNG19_RFL8_SIG16_NIR16 or of that size"
    assert model_of(b"") == model_of(bytes(48)) == model_of(b"\xee\xff") == ""


def source(tmp_path: Path, data: bytes, name: str = "street.pcap", query: str = "") -> list:
    (tmp_path / name).write_bytes(data)
    url = f"file:{tmp_path / name}?rate=0{query}"
    return [frame for _, frame in open_source(InfraLidarConfig(source=url), Report("test"))]


def turn(sender: str = "192.168.1.201", product: int = 0xA1) -> list[bytes]:
    packets = [vls_packet((0.6 * k) % 360, time_us=166 * k, product=product) for k in range(1205)]
    return [ethernet(ipv4(packet, sender)) for packet in packets]


@pytest.mark.parametrize(
    ("frames", "words"),
    [
        (
            [ethernet(ipv4(HESAI, "192.168.1.5"))],
            "Hesai with 128 beams, protocol 1.3 at 192.168.1.5, port 2368 (not supp",
        ),
        ([ethernet(ipv4(RUBY))], "RoboSense (RS-80 or Helios kind) at 192.168.1.201"),
        ([ethernet(ipv4(vls_packet(0.0, product=0x22)))], "Velodyne VLP-16 at"),
        ([ethernet(ipv4(b"a stranger"))], "no packets of a lidar that we know. Supported: Velodyne VLS-128, Ouster"),
        ([ethernet(ipv4(bytes(24832)))], "no Ouster metadata"),
    ],
)
def test_what_is_not_supported_is_named(tmp_path: Path, frames: list[bytes], words: str) -> None:
    with pytest.raises(ConfigError) as raised:
        source(tmp_path, pcap(*frames))
    assert words in str(raised.value)


def test_metadata_of_another_mode_are_refused(tmp_path: Path) -> None:
    (tmp_path / "street.json").write_text(metadata("RNG15_RFL8_NIR8", beams=4))
    with pytest.raises(ConfigError, match=r"metadata of another mode\?"):
        source(tmp_path, pcap(ethernet(ipv4(bytes(24832)))))


def test_of_two_sensors_one_is_chosen_by_name(tmp_path: Path) -> None:
    both = [frame for pair in zip(turn(), turn("192.168.1.202"), strict=True) for frame in pair]
    with pytest.raises(ConfigError, match=r"several sensors: .*1\.201.*; .*1\.202.*\?from=ADDRESS"):
        source(tmp_path, pcap(*both))
    frames = source(tmp_path, pcap(*both), query="&from=192.168.1.202")
    assert [frame.quality.packets_lost for frame in frames] == [0, 0]


@pytest.mark.parametrize("name", ["street.PCAP", "street.pcapng", "street.cap", "street.pcap.gz"])
def test_the_name_does_not_matter(tmp_path: Path, name: str) -> None:
    data = pcapng(*turn()) if name.endswith("ng") else pcap(*turn())
    data = gzip.compress(data, mtime=0) if name.endswith("gz") else data
    assert len(source(tmp_path, data, name)) == 2


TWO_KINDS = pcap(*turn(), ethernet(ipv4(b"a stranger", "192.168.1.9", 9000)))


@pytest.mark.parametrize(
    ("query", "words"),
    [
        (
            "&from=1.2.3.4",
            "no packets of from=1.2.3.4; in the capture: 192.168.1.201, port 2368; 192.168.1.9, port 9000",
        ),
        ("&port=7", "no packets of port=7; in the capture: 192.168.1.201, port 2368"),
        ("&from=192.168.1.201&port=9000", "no packets of from=192.168.1.201, port=9000; in the capture"),
    ],
)
@pytest.mark.parametrize("has_metadata", [False, True])
def test_what_is_asked_for_and_not_there_is_named(tmp_path: Path, query: str, words: str, has_metadata: bool) -> None:
    if has_metadata:
        (tmp_path / "street.json").write_text(metadata())
    with pytest.raises(ConfigError) as raised:
        source(tmp_path, TWO_KINDS, query=query)
    assert words in str(raised.value)


def test_an_address_that_sends_nothing_of_a_lidar_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as raised:
        source(tmp_path, TWO_KINDS, query="&from=192.168.1.9")
    words = "we know of from=192.168.1.9; in the capture: Velodyne VLS-128 at 192.168.1.201"
    assert words in str(raised.value)
