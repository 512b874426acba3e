"""Captures of several interfaces and sections, and packets that cannot be used: no stamp, cut, other links."""

from __future__ import annotations

import contextlib
import io
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.infra_lidar.input.captures import CaptureError, read_capture
from services.infra_lidar.input.pcapng import PcapngReader
from tests.infra_lidar.made_captures import ethernet, ipv4, ipv6, pcap, pcapng, udp

ETHERNET, RAW_IP, USB = 1, 101, 189
SECOND_NS = 1_000_000_000
IN_IP, IN_ETHERNET = ipv4(b"in IP"), ethernet(ipv4(b"in ethernet"))


def block(kind: int, body: bytes, order: str = "<") -> bytes:
    body += bytes(-len(body) % 4)
    length = struct.pack(order + "I", len(body) + 12)
    return struct.pack(order + "I", kind) + length + body + length


def section(order: str = "<") -> bytes:
    return block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1), order)


def interface(link: int, resolution: int | None = None, offset_s: int = 0, order: str = "<") -> bytes:
    options = b"" if resolution is None else struct.pack(order + "HHB3x", 9, 1, resolution)
    options += struct.pack(order + "HHq", 14, 8, offset_s) if offset_s else b""
    return block(1, struct.pack(order + "HHI", link, 0, 0) + options + bytes(4), order)


def packet(number: int, ticks: int, frame: bytes, order: str = "<") -> bytes:
    head = struct.pack(order + "IIIII", number, ticks >> 32, ticks & 0xFFFFFFFF, len(frame), len(frame))
    return block(6, head + frame, order)


def old_packet(number: int, ticks: int, frame: bytes) -> bytes:
    return block(2, struct.pack("<HHIIII", number, 0, ticks >> 32, ticks & 0xFFFFFFFF, len(frame), len(frame)) + frame)


def simple_packet(frame: bytes) -> bytes:
    return block(3, struct.pack("<I", len(frame)) + frame)


@pytest.mark.parametrize(
    ("data", "found"),
    [
        (
            section()
            + interface(RAW_IP)
            + interface(ETHERNET)
            + packet(1, 7_000_000, IN_ETHERNET)
            + packet(0, 8_000_000, IN_IP),
            [(7 * SECOND_NS, b"in ethernet"), (8 * SECOND_NS, b"in IP")],
        ),
        (
            section()
            + interface(ETHERNET)
            + interface(ETHERNET, 9)
            + packet(1, 1_700_000_000_123_456_789, IN_ETHERNET),
            [(1_700_000_000_123_456_789, b"in ethernet")],
        ),
        (
            section() + interface(ETHERNET, 0x80 | 10, 50) + packet(0, 512, IN_ETHERNET),
            [(50 * SECOND_NS + SECOND_NS // 2, b"in ethernet")],
        ),
        (
            section() + interface(USB) + interface(ETHERNET) + packet(0, 1, b"mouse") + packet(1, 2, IN_ETHERNET),
            [(2000, b"in ethernet")],
        ),
        (
            section(">")
            + interface(RAW_IP, order=">")
            + packet(0, 1, IN_IP, ">")
            + section()
            + interface(ETHERNET, 9)
            + packet(0, 5, IN_ETHERNET),
            [(1000, b"in IP"), (5, b"in ethernet")],
        ),
        (
            section() + interface(USB) + packet(0, 1, b"") + interface(RAW_IP) + old_packet(1, 3, IN_IP),
            [(3000, b"in IP")],
        ),
        (
            section() + interface(ETHERNET) + simple_packet(IN_ETHERNET) + packet(0, 4, IN_ETHERNET),
            [(4000, b"in ethernet")],
        ),
        (section() + interface(ETHERNET), []),
    ],
    ids=["links", "clocks", "power of 2", "link not known", "sections", "old packets", "no stamp", "nothing"],
)
def test_each_packet_has_its_own_interface(data: bytes, found: list[tuple[int, bytes]]) -> None:
    assert [(one.stamp_ns, one.payload) for one in read_capture(io.BytesIO(data))] == found


CUT4, CUT6 = ethernet(ipv4(bytes(200)))[:100], ethernet(ipv6(udp(bytes(200))))[:100]


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (pcap(IN_ETHERNET, link=USB), "link layer 189 is not known"),
        (pcapng(IN_ETHERNET, link=USB), "1 packets: link layer 189 is not known"),
        (section() + interface(ETHERNET) + simple_packet(IN_ETHERNET), r"1 packets have no stamp \(pcapng simple "),
        (section(), "no pcap or pcapng capture, or a damaged one .*no interface is described"),
    ],
    ids=["pcap link", "link", "no stamps", "no interface"],
)
def test_a_capture_of_which_nothing_can_be_used_is_refused(data: bytes, words: str) -> None:
    with pytest.raises(CaptureError, match=words):
        list(read_capture(io.BytesIO(data)))


@pytest.mark.parametrize(
    ("data", "payloads", "cut"),
    [
        (pcap(CUT4, CUT6), [], 2),
        (pcapng(CUT4), [], 1),
        (pcap(CUT4, IN_ETHERNET), [b"in ethernet"], 1),
        (pcap(IN_ETHERNET), [b"in ethernet"], 0),
    ],
)
def test_packets_that_are_cut_are_left_out_and_logged(
    data: bytes, payloads: list[bytes], cut: int, caplog: pytest.LogCaptureFixture
) -> None:
    assert [one.payload for one in read_capture(io.BytesIO(data))] == payloads
    expected = [f"capture: left out: {cut} UDP packets are cut, by the capture's snap length"] if cut else []
    assert [record.getMessage()[: len(expected[0])] for record in caplog.records] == expected


def test_the_bits_of_a_frame_check_sequence_are_no_link_layer() -> None:
    (datagram,) = read_capture(io.BytesIO(pcap(IN_ETHERNET + bytes(4), link=0x54000001)))
    assert datagram.payload == b"in ethernet"


@pytest.mark.parametrize(
    "wrong",
    [packet(1, 1, IN_ETHERNET), packet(0, 1, IN_ETHERNET)[:-9], block(6, bytes(8)), b"\6\0\0\0\xff\xff\xff\xff", b"\6"],
    ids=["interface not there", "cut", "short", "huge", "one byte"],
)
def test_what_is_damaged_ends_the_capture(wrong: bytes, caplog: pytest.LogCaptureFixture) -> None:
    data = section() + interface(ETHERNET) + packet(0, 1, IN_ETHERNET) + wrong
    assert len(list(read_capture(io.BytesIO(data)))) == 1
    assert "cut or damaged behind packet 1" in caplog.text


WHOLE = section() + interface(ETHERNET, 9) + packet(0, 1, IN_ETHERNET) + old_packet(0, 2, IN_ETHERNET)


@given(st.lists(st.tuples(st.integers(0, len(WHOLE) - 1), st.integers(1, 255)), max_size=4), st.integers(0, len(WHOLE)))
def test_damage_raises_what_the_reader_says(flips: list[tuple[int, int]], length: int) -> None:
    data = bytearray(WHOLE)
    for at, bits in flips:
        data[at] ^= bits
    with contextlib.suppress(ValueError, EOFError, struct.error):
        assert len(list(PcapngReader(io.BytesIO(data[:length])))) <= 2
