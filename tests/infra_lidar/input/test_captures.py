"""Captures of every container and link layer, of sensors that are supported and others, and of several at once."""

from __future__ import annotations

import contextlib
import gzip
import io
import struct
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.bus.status import Report
from common.config import ConfigError
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.captures import CaptureError, read_capture
from services.infra_lidar.input.senders import print_senders
from services.infra_lidar.input.sensors import model_of
from services.infra_lidar.input.source import open_source
from tests.infra_lidar.made_packets import metadata, vls_packet

ETHERNET, COOKED, COOKED2 = 1, 113, 276


def udp(payload: bytes, port: int = 2368) -> bytes:
    return struct.pack(">HHHH", 9, port, len(payload) + 8, 0) + payload


def ipv4(payload: bytes, sender: str = "192.168.1.201", port: int = 2368) -> bytes:
    body = udp(payload, port)
    address = bytes(map(int, sender.split(".")))
    return struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(body), 1, 0, 64, 17, 0, address, b"\xff" * 4) + body


def ipv6(body: bytes, following: int = 17) -> bytes:
    return struct.pack(">IHBB", 6 << 28, len(body), following, 64) + bytes(15) + b"\x01" + bytes(16) + body


def ethernet(packet: bytes, tags: tuple[int, ...] = ()) -> bytes:
    kind = struct.pack(">H", 0x86DD if packet[0] >> 4 == 6 else 0x0800)
    vlan = b"".join(struct.pack(">HH", tag, 7) for tag in tags)
    return bytes(12) + vlan + kind + packet


def cooked(packet: bytes, tags: tuple[int, ...] = ()) -> bytes:
    types = [*tags, 0x0800]
    inner = b"".join(struct.pack(">HH", 7, following) for following in types[1:])
    return bytes(14) + struct.pack(">H", types[0]) + inner + packet


def pcap(*frames: bytes, link: int = ETHERNET, order: str = "<", nanoseconds: bool = False) -> bytes:
    data = struct.pack(order + "IHHIIII", 0xA1B23C4D if nanoseconds else 0xA1B2C3D4, 2, 4, 0, 0, 65535, link)
    for number, frame in enumerate(frames):
        data += struct.pack(order + "IIII", 100 + number, 5, len(frame), len(frame)) + frame
    return data


def pcapng(*frames: bytes, link: int = ETHERNET, order: str = "<") -> bytes:
    def block(kind: int, body: bytes) -> bytes:
        body += bytes(-len(body) % 4)
        length = struct.pack(order + "I", len(body) + 12)
        return struct.pack(order + "I", kind) + length + body + length

    data = block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1))
    data += block(1, struct.pack(order + "HHI", link, 0, 65535))
    for number, frame in enumerate(frames):
        stamp = (100 + number) * 1_000_000 + 5
        head = struct.pack(order + "IIIII", 0, stamp >> 32, stamp & 0xFFFFFFFF, len(frame), len(frame))
        data += block(6, head + frame)
    return data


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


def test_fragments_of_ipv6_are_joined() -> None:
    whole = udp(bytes(range(200)))

    def part(start: int, stop: int, more: bool) -> bytes:
        head = struct.pack(">BBHI", 17, 0, start | more, 77)
        return ethernet(ipv6(head + whole[start:stop], following=44))

    (datagram,) = read_capture(io.BytesIO(pcap(part(96, 208, False), part(0, 96, True))))
    assert datagram.payload == bytes(range(200))


def fragment(payload: bytes, start: int, stop: int) -> bytes:
    """Bytes of a UDP datagram as a fragment of IPv4, on a link without padding; all have the same identity."""
    body = udp(payload)
    flags = start // 8 | (0x2000 if stop < len(body) else 0)
    head = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(body[start:stop]), 7, flags, 64, 17, 0, b"\1" * 4, b"\2" * 4)
    return ethernet(head + body[start:stop])


OLD, NEW = bytes([1]) * 200, bytes([2]) * 200
OLD_PARTS, NEW_PARTS = ([fragment(data, *part) for part in ((0, 96), (96, 192), (192, 208))] for data in (OLD, NEW))


@pytest.mark.parametrize(
    ("parts", "wait_s", "payloads"),
    [
        (OLD_PARTS[1:] + NEW_PARTS * 2, 30, [NEW, NEW]),  # the identity comes again, the first of the old one was lost
        (OLD_PARTS[:1] + NEW_PARTS[1:], 30, []),
        (OLD_PARTS[:2] + NEW_PARTS * 2, 0, [NEW, NEW]),  # at once, and the last of the old one was lost
        (OLD_PARTS[:1] + NEW_PARTS[:1] + NEW_PARTS[2:], 0, []),  # the second was lost of both
        (NEW_PARTS[:1] * 2 + NEW_PARTS[1:], 0, [NEW]),  # a mirror port sends it twice
        (NEW_PARTS[1:] + NEW_PARTS[:1], 0, [NEW]),
    ],
    ids=["old first lost", "both lost", "old last lost", "old second lost", "doubled", "first comes last"],
)
def test_fragments_of_two_packets_are_not_joined(parts: list[bytes], wait_s: int, payloads: list[bytes]) -> None:
    data = bytearray(pcap(*parts))
    at = 24
    for number, part in enumerate(parts):
        later = number >= len([one for one in parts if one in OLD_PARTS])
        struct.pack_into("<I", data, at, 100 + (wait_s if later else 0))
        at += 16 + len(part)
    assert [datagram.payload for datagram in read_capture(io.BytesIO(data))] == payloads


@pytest.mark.parametrize("rest", range(1, 9))
def test_a_last_fragment_of_few_bytes_is_read(rest: int) -> None:
    payload = bytes(range(88)) + bytes(rest)
    (datagram,) = read_capture(io.BytesIO(pcap(fragment(payload, 0, 96), fragment(payload, 96, 96 + rest))))
    assert datagram.payload == payload


@pytest.mark.parametrize(
    "data",
    [pcap(FIRST, FIRST), pcapng(FIRST, FIRST), gzip.compress(pcap(FIRST, FIRST), mtime=0)],
    ids=["pcap", "pcapng", "gzip"],
)
def test_a_capture_that_is_cut_gives_what_is_whole(data: bytes) -> None:
    assert len(list(read_capture(io.BytesIO(data[:-9])))) <= 2
    assert next(iter(read_capture(io.BytesIO(data[: 9 * len(data) // 10])))).payload == b"first"


# --- damage ---

ZIPPED = gzip.compress(pcap(*[ethernet(ipv4(bytes([k, 91 * k % 256, 57 * k % 256]) * 40)) for k in range(40)]), mtime=0)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (ZIPPED[:8], r"damaged one \(Compressed file ended"),
        (ZIPPED[:30], r"damaged one \(Compressed file ended"),
        (b"\x1f\x8bjunk of some length", r"damaged one \(Unknown compression method"),
        (ZIPPED[:10] + b"\xff" * 40, r"damaged one \(Error -3 while decompressing"),
        (pcapng(FIRST)[:8], r"damaged one \(got 8, 24 needed"),
    ],
    ids=["cut in the head", "cut in the data", "junk", "damaged data", "pcapng cut"],
)
def test_damage_at_the_beginning_is_told_by_the_service_and_by_look(tmp_path: Path, data: bytes, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        source(tmp_path, data, "short.pcap.gz")
    with pytest.raises(ConfigError, match=rf"short\.pcap\.gz: .*{words}"):
        print_senders(str(tmp_path / "short.pcap.gz"), 1.0)


def test_damage_farther_on_ends_the_capture_and_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    at = len(ZIPPED) // 2
    damaged = ZIPPED[:at] + bytes(80) + ZIPPED[at + 80 :]
    assert len(list(read_capture(io.BytesIO(damaged)))) < 40
    assert "cut or damaged behind packet" in caplog.text
    assert "the rest is left out" in caplog.text


@settings(max_examples=200, deadline=None)
@given(share=st.floats(0, 1), wrong=st.binary(max_size=8), cut=st.booleans())
def test_a_damaged_gzip_is_read_or_refused(share: float, wrong: bytes, cut: bool) -> None:
    at = int(share * len(ZIPPED))
    damaged = ZIPPED[:at] if cut else ZIPPED[:at] + wrong + ZIPPED[at + len(wrong) :]
    with contextlib.suppress(CaptureError):
        assert len(list(read_capture(io.BytesIO(damaged)))) <= 40


@pytest.mark.parametrize("length", range(8))
def test_a_fragment_of_ipv6_without_its_whole_header_is_left_out(length: int) -> None:
    short = ipv6(bytes([17, 0, 0, 1, 0, 0, 0, 7])[:length], following=44)
    frames = [ethernet(short + bytes(8)), FIRST]  # with padding of the link layer
    assert [datagram.payload for datagram in read_capture(io.BytesIO(pcap(*frames)))] == [b"first"]


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
    with pytest.raises(ConfigError) as told:
        source(tmp_path, pcap(*frames))
    assert words in str(told.value)


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
