"""LD06 bytes -> packets: the manual's values, any chunking, nothing skipped, nothing believed that is spoiled."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.jetson.lidar.parser import PACKET_BYTES, Ld06Parser, Packet, crc8, crc_table
from spotter_sim import ld06

SlowParse = Callable[..., list[bytes]]

# The example of the LDROBOT development manual, and what the manual says it means. (Its table misprints the last
# point as 176 mm / 234; the bytes, and so the CRC, say 192 mm / 229.)
MANUAL = bytes.fromhex("542C6808AB7EE000E4DC00E2D900E5D500E3D300E4D000E9CD00E4CA00E2C700E9C500E5C200E5C000E5BE823A1A50")


def some_packets(count: int = 20, seed: int = 0) -> list[bytes]:
    """Packets of a sensor that turns at 10 Hz, with every kind of payload."""
    rng = np.random.default_rng(seed)
    packets = []
    for number in range(count):
        start = (number * 960 + 35000) % 36000
        mm, confidence = rng.integers(0, 12_000, 12), rng.integers(0, 256, 12)
        packets.append(ld06.encode_packet(start, start + 880, mm, confidence, number * 8 // 3))
    return packets


def payload_with_header() -> bytes:
    """A packet whose payload holds two header look-alikes."""
    mm, confidence = np.full(12, 0x2C54), np.full(12, 0x54)
    return ld06.encode_packet(1000, 1880, mm, confidence, 77)


def content(packets: list[Packet]) -> list[tuple]:
    return [
        (p.speed_dps, p.start_deg, p.end_deg, p.timestamp_ms, p.distances_mm.tobytes(), p.confidence.tobytes())
        for p in packets
    ]


def test_crc_table_and_check_value(slow_crc: Callable[[bytes], int]) -> None:
    table = crc_table()
    assert (table[1], table[2], table[255]) == (0x4D, 0x9A, 0xA8)
    assert table.tolist() == [slow_crc(bytes([byte])) for byte in range(256)]
    assert slow_crc(b"123456789") == 0xC3
    # Zeros in front do not change a CRC that starts at 0: so the golden value fits into a row of 46.
    padded = np.frombuffer(bytes(37) + b"123456789", np.uint8)[None]
    assert crc8(padded)[0] == 0xC3


@given(st.binary(min_size=46, max_size=46))
def test_fast_crc_equals_slow_crc(slow_crc: Callable[[bytes], int], message: bytes) -> None:
    assert crc8(np.frombuffer(message, np.uint8)[None])[0] == slow_crc(message)


def test_manual_example() -> None:
    (packet,) = Ld06Parser().feed(MANUAL)
    assert packet.speed_dps == 2152
    assert (packet.start_deg, packet.end_deg) == (324.27, 334.7)
    assert packet.timestamp_ms == 0x1A3A
    assert packet.distances_mm.tolist() == [224, 220, 217, 213, 211, 208, 205, 202, 199, 197, 194, 192]
    assert packet.confidence.tolist() == [228, 226, 229, 227, 228, 233, 228, 226, 233, 229, 229, 229]
    expected_deg = 324.27 + (334.7 - 324.27) / 11 * np.arange(12)
    np.testing.assert_allclose(packet.angles_deg, expected_deg, atol=1e-9)
    np.testing.assert_allclose(packet.angles_rad, -np.radians(expected_deg), atol=1e-12)
    np.testing.assert_allclose(packet.ranges_m, packet.distances_mm / 1000)


def test_manual_example_is_from_older_firmware() -> None:
    parser = Ld06Parser(sample_rate_hz=4500.0)
    assert parser.feed(MANUAL) == []
    assert parser.counters["angle_span"] == 1


def test_real_packets(real_packets: list[bytes]) -> None:
    parsers = [Ld06Parser() for _ in real_packets]
    packets = [parser.feed(raw) for parser, raw in zip(parsers, real_packets, strict=True)]
    assert [len(one) for one in packets] == [1, 1, 1]
    assert packets[1][0].distances_mm.tolist() == [0] * 12
    tenth_hz = packets[2][0]
    assert tenth_hz.speed_dps == 3601
    assert (tenth_hz.start_deg, tenth_hz.end_deg) == (97.33, 106.07)
    assert tenth_hz.distances_mm.tolist() == [447, 451, 453, 461, 465, 474, 479, 481, 486, 471, 463, 459]


def test_every_single_bit_error_of_real_packets_is_rejected(real_packets: list[bytes]) -> None:
    for raw in [*real_packets, payload_with_header()]:
        for bit in range(PACKET_BYTES * 8):
            spoiled = bytearray(raw)
            spoiled[bit // 8] ^= 1 << bit % 8
            parser = Ld06Parser()
            # Between two good packets, so that resynchronisation is tried as well
            found = parser.feed(raw + bytes(spoiled) + raw)
            assert content(found) == content(Ld06Parser().feed(raw) * 2)
            assert sum(parser.counters[name] for name in ("crc", "skipped_bytes")) >= 47


@given(st.data())
def test_any_chunking_gives_the_same_packets_and_counts(data: st.DataObject) -> None:
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    stream = bytearray(b"".join([*some_packets(12), payload_with_header(), *some_packets(5, seed=1)]))
    for _ in range(data.draw(st.integers(0, 4))):  # spoil, cut, insert
        at = int(rng.integers(len(stream)))
        stream[at : at + int(rng.integers(0, 60))] = rng.bytes(int(rng.integers(0, 60)))
    whole = Ld06Parser()
    expected = content(whole.feed(bytes(stream)))
    pieces = Ld06Parser()
    found, at = [], 0
    while at < len(stream):
        size = data.draw(st.integers(1, 200))
        found += pieces.feed(bytes(stream[at : at + size]))
        at += size
        assert pieces.pending < PACKET_BYTES
    assert content(found) == expected
    assert +pieces.counters == +whole.counters
    assert whole.counters["skipped_bytes"] + whole.pending + PACKET_BYTES * len(found) == len(stream)


@given(st.lists(st.one_of(st.binary(max_size=60), st.sampled_from(["packet", "header", "tease"])), max_size=30))
def test_equals_the_slow_parser(slow_parse: SlowParse, pieces: list[bytes | str]) -> None:
    words = {"packet": payload_with_header(), "header": b"\x54\x2c", "tease": b"\x54\x54\x2c" + MANUAL[2:40]}
    stream = b"".join(words[piece] if isinstance(piece, str) else piece for piece in pieces)
    expected = content([packet for raw in slow_parse(stream) for packet in Ld06Parser().feed(raw)])
    assert content(Ld06Parser().feed(stream)) == expected


@pytest.mark.parametrize(
    ("name", "before"),
    [
        ("a second 0x54 before the header", b"\x54"),
        ("a header without its packet", b"\x54\x2c"),
        ("a packet cut off in the middle", MANUAL[:30]),
        ("a packet cut off before its last byte", MANUAL[:46]),
        ("a start in the middle of a packet", MANUAL[20:]),
        ("noise", bytes(range(0x60, 0x90))),
        ("a packet with a wrong CRC", MANUAL[:46] + b"\x51"),
    ],
)
def test_a_true_header_is_never_skipped(name: str, before: bytes) -> None:
    parser = Ld06Parser()
    assert len(parser.feed(before + MANUAL)) == 1, name
    assert parser.counters["skipped_bytes"] == len(before)


@pytest.mark.parametrize(
    ("counter", "packet"),
    [
        ("angle_range", (36_001, 36_880, 3600, 5)),
        ("angle_span", (0, 9000, 3600, 5)),
        ("speed_range", (0, 880, 9000, 5)),
        ("timestamp_range", (0, 880, 3600, 30_001)),
    ],
)
def test_implausible_fields_are_rejected_and_counted(
    counter: str, packet: tuple[int, int, int, int], slow_crc: Callable[[bytes], int]
) -> None:
    start, end, speed, stamp = packet
    body = bytearray(ld06.encode_packet(0, 880, np.full(12, 500), np.full(12, 200), 0)[:46])
    for offset, value in ((2, speed), (4, start), (42, end), (44, stamp)):
        body[offset : offset + 2] = value.to_bytes(2, "little")
    parser = Ld06Parser(sample_rate_hz=4500.0)
    assert parser.feed(bytes(body) + bytes([slow_crc(bytes(body))])) == []
    assert parser.counters[counter] == 1


def test_timestamp_30000_is_accepted_and_a_standing_motor_too() -> None:
    body = bytearray(ld06.encode_packet(100, 100, np.full(12, 500), np.full(12, 200), 0, speed_dps=0)[:46])
    body[44:46] = (30_000).to_bytes(2, "little")
    (packet,) = Ld06Parser(sample_rate_hz=4500.0).feed(bytes(body) + bytes([ld06.crc8(bytes(body))]))
    assert packet.timestamp_ms == 30_000
    assert np.ptp(packet.angles_rad) == 0.0


@given(st.integers(0, 35_999), st.integers(0, 1600))
def test_interpolation_at_full_precision_and_across_the_wrap(start_cdeg: int, span_cdeg: int) -> None:
    raw = ld06.encode_packet(start_cdeg, start_cdeg + span_cdeg, np.zeros(12), np.zeros(12), 0, speed_dps=7200)
    (packet,) = Ld06Parser().feed(raw)
    expected_deg = start_cdeg / 100 + np.arange(12) * span_cdeg / 100 / 11
    np.testing.assert_allclose(np.unwrap(packet.angles_rad), -np.radians(expected_deg), atol=1e-9)
    away_deg = (packet.angles_deg - expected_deg + 180.0) % 360.0 - 180.0
    np.testing.assert_allclose(away_deg, 0.0, atol=1e-9)
    # The vendor's SDK floors the step to 0.01 degree: never more than 0.11 degree away
    vendor_deg = start_cdeg / 100 + np.arange(12) * (span_cdeg // 11) / 100
    assert np.abs(expected_deg - vendor_deg).max() <= 0.11


def test_random_bytes_pass_only_as_often_as_eight_bits_must_let_through(slow_parse: SlowParse) -> None:
    """Two header bytes and an 8-bit CRC let one position in 2^24 through; plausibility lets hardly any of those."""
    data = np.random.default_rng(5).integers(0, 256, 20_000_000, dtype=np.uint8).tobytes()
    parser = Ld06Parser()
    found = parser.feed(data)
    candidates = len(data) / 2**16
    passed = sum(parser.counters[name] for name in ("angle_range", "angle_span", "speed_range", "timestamp_range"))
    assert abs(parser.counters["crc"] - candidates) < 6 * np.sqrt(candidates)
    assert len(found) + passed <= 12  # expected 20e6 / 2^24 = 1.2; the seed makes it exact
    assert parser.pending < PACKET_BYTES
    assert content(found) == content([p for raw in slow_parse(data[:2_000_000]) for p in Ld06Parser().feed(raw)])


@settings(max_examples=30)
@given(st.binary(max_size=5000))
def test_random_bytes_never_raise_and_memory_is_bounded(data: bytes) -> None:
    parser = Ld06Parser()
    for at in range(0, len(data), 100):
        parser.feed(data[at : at + 100])
        assert parser.pending < PACKET_BYTES


def test_a_unit_that_counts_counter_clockwise() -> None:
    (packet,) = Ld06Parser(clockwise=False).feed(MANUAL)
    np.testing.assert_allclose(packet.angles_rad, np.radians(packet.angles_deg))
