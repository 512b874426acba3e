"""Captures that are cut or damaged, and IP fragments, of which some are lost."""

from __future__ import annotations

import contextlib
import gzip
import io
import struct
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.bus.status import Report
from common.config import ConfigError
from services.infra_lidar.config import InfraLidarConfig
from services.infra_lidar.input.captures import CaptureError, read_capture
from services.infra_lidar.input.senders import print_senders
from services.infra_lidar.input.source import open_source
from tests.infra_lidar.made_captures import ethernet, ipv4, ipv6, pcap, pcapng, udp

FIRST = ethernet(ipv4(b"first"))


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


ZIPPED = gzip.compress(pcap(*[ethernet(ipv4(bytes([k, 91 * k % 256, 57 * k % 256]) * 40)) for k in range(40)]), mtime=0)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (ZIPPED[:8], r"damaged one \(Compressed file ended"),
        (ZIPPED[:30], r"damaged one \(Compressed file ended"),
        (b"\x1f\x8bjunk of some length", r"damaged one \(Unknown compression method"),
        (ZIPPED[:10] + b"\xff" * 40, r"damaged one \(Error -3 while decompressing"),
        (pcapng(FIRST)[:8], r"damaged one \(no whole pcapng block"),
    ],
    ids=["cut in the head", "cut in the data", "junk", "damaged data", "pcapng cut"],
)
def test_damage_at_the_beginning_is_told_by_the_service_and_by_look(tmp_path: Path, data: bytes, words: str) -> None:
    path = tmp_path / "short.pcap.gz"
    path.write_bytes(data)
    with pytest.raises(ConfigError, match=words):
        open_source(InfraLidarConfig(source=f"file:{path}"), Report("test"))
    with pytest.raises(ConfigError, match=rf"short\.pcap\.gz: .*{words}"):
        print_senders(str(path), 1.0)


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
