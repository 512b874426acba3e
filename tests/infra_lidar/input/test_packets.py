"""Velodyne and Ouster packets, captures and bags: built here byte by byte, and recordings against decoded points."""

import io
import json
import struct
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.infra_lidar.input.bags import open_bag, packets_of
from services.infra_lidar.input.captures import CaptureError, read_capture
from services.infra_lidar.input.ouster import OusterFormat, OusterParser
from services.infra_lidar.input.ouster_metadata import MetadataError
from services.infra_lidar.input.velodyne import PACKET_BYTES, RING, Vls128Parser
from tests.infra_lidar.made_packets import metadata, ouster_packet, revolutions_of, vls_packet


def test_a_vls128_turn_in_numbers():
    (revolution,) = revolutions_of(Vls128Parser())
    assert revolution.points.shape == (600 * 384, 5)
    assert revolution.quality.complete
    assert revolution.quality.packets_lost == 0
    assert np.allclose(np.linalg.norm(revolution.points[:, :3], axis=1), 10.0, atol=0.02)
    assert set(revolution.points[:, 4].astype(int)) == set(range(128))
    assert (revolution.points[:, 3] == 77).all()
    # laser 36 looks down 25 degrees, laser 59 up 15 (user manual, table of vertical angles)
    first = revolution.points[:128]
    elevation = np.degrees(np.arctan2(first[:, 2], np.hypot(first[:, 0], first[:, 1])))
    assert elevation[36] == pytest.approx(-25.0, abs=0.2)
    assert elevation[59] == pytest.approx(15.0, abs=0.2)
    assert RING[36] == 0
    assert RING[59] == 127
    # laser 0 looks 6.354 degrees to one side of the head, which turns clockwise from x
    assert np.degrees(np.arctan2(-first[0, 1], first[0, 0])) == pytest.approx(6.354, abs=0.01)


def test_lost_packets_and_partial_revolutions_are_counted():
    parser = Vls128Parser()
    revolutions = []
    for k in range(1, 620):
        if 100 <= k < 130:  # 30 packets, 18 degrees
            continue
        done = parser.feed(vls_packet((0.6 * k) % 360, time_us=166 * k), k)
        revolutions += [done] if done is not None else []
    assert revolutions[0].quality.packets_lost == 30
    assert [revolution.quality.complete for revolution in revolutions] == [False]


@pytest.mark.parametrize(
    "packet",
    [b"", bytes(PACKET_BYTES), vls_packet(0)[:-1], vls_packet(0, product=0x22), vls_packet(0)[:2] + b"\xff" * 1204],
)
def test_other_packets_are_rejected(packet):
    parser = Vls128Parser()
    assert parser.feed(packet, 0) is None
    assert parser.rejected == 1


def test_no_returns_and_unknown_banks_give_no_points():
    (revolution,) = revolutions_of(Vls128Parser(), steps=0)
    assert revolution.range_image.returns == 0
    assert not revolution.points.any()
    (revolution,) = revolutions_of(Vls128Parser(), flags=(0xEEFF, 0x1234, 0xCCFF, 0x4321))
    assert revolution.range_image.returns == len(revolution.points) == 600 * 192


@settings(max_examples=50, deadline=None)
@given(st.lists(st.binary(min_size=PACKET_BYTES, max_size=PACKET_BYTES), max_size=5), st.booleans())
def test_garbage_never_stops_the_parser(packets, signed):
    parser = Vls128Parser()
    for packet in packets:
        parser.feed(packet[:-1] + b"\xa1" if signed else packet, 0)
    revolutions_of(parser)


@pytest.mark.parametrize(
    "profile", ["LEGACY", "RNG19_RFL8_SIG16_NIR16", "RNG19_RFL8_SIG16_NIR16_DUAL", "RNG15_RFL8_NIR8"]
)
def test_an_ouster_turn_in_numbers(profile):
    layout = OusterFormat(metadata(profile))
    parser = OusterParser(layout)
    done = [parser.feed(ouster_packet(layout, 7, c), c) for c in range(0, 64, 16)]
    revolution = parser.feed(ouster_packet(layout, 8, 0), 99)
    assert not any(done)
    points = revolution.range_image.sample(1)
    assert points.shape == (64 * 4, 5)
    assert revolution.quality.complete
    assert revolution.stamp_ns == 48
    ahead = points[:4]  # column 0 looks along x
    assert np.allclose(ahead[1], [8.0, 0.0, 0.0, ahead[1, 3], 2.0], atol=1e-3)
    assert np.allclose(ahead[0, :3], [8 * np.cos(np.radians(20)), 0, 8 * np.sin(np.radians(20))], atol=1e-3)
    quarter = points[4 * 16 + 1]  # the head turns clockwise: after a quarter it looks to the right
    assert np.allclose(quarter[:3], [0.0, -8.0, 0.0], atol=1e-3)


def test_an_ousters_beams_start_from_an_arm_and_its_frame_is_turned():
    """A range counts from the origin of the lidar: along the arm that turns with the head, then along the beam."""
    half_turn = [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.0, 0, 0, 0, 1]
    text = metadata(
        lidar_origin_to_beam_origin_mm=15.0, lidar_to_sensor_transform=half_turn,
        beam_azimuth_angles=[3.0, 1.0, -1.0, -3.0],
    )  # fmt: skip
    layout = OusterFormat(text)
    parser = OusterParser(layout)
    parser.feed(ouster_packet(layout, 7, 16), 0)
    points = parser.flush().range_image.sample(1)
    for k, point in enumerate(points):
        column, beam = 16 + k // 4, k % 4
        encoder = 2 * np.pi * (1 - column / 64)
        azimuth, altitude = -np.radians([3.0, 1.0, -1.0, -3.0][beam]), np.radians([20.0, 0.0, -10.0, -20.0][beam])
        heading, along = encoder + azimuth, 8.0 - 0.015
        xyz = along * np.array(
            [np.cos(heading) * np.cos(altitude), np.sin(heading) * np.cos(altitude), np.sin(altitude)]
        )
        xyz += 0.015 * np.array([np.cos(encoder), np.sin(encoder), 0.0])
        np.testing.assert_allclose(point[:3], [-xyz[0], -xyz[1], xyz[2] + 0.036], atol=1e-4)
        assert point[4] == 3 - beam


def test_ouster_losses_invalid_columns_and_strangers():
    layout = OusterFormat(metadata())
    parser = OusterParser(layout)
    parser.feed(ouster_packet(layout, 1, 0), 0)
    parser.feed(ouster_packet(layout, 1, 48, valid=0), 0)
    parser.feed(b"another service", 0)
    revolution = parser.feed(ouster_packet(layout, 2, 0), 0)
    assert revolution.quality.packets_lost == 2
    assert not revolution.quality.complete
    assert revolution.range_image.returns == 16 * 4
    assert parser.rejected == 1
    assert parser.flush().range_image.returns == 16 * 4
    assert parser.flush() is None


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "[" * 100_000,
        "{}",
        metadata("SMOKE"),
        metadata(beams=5),
        metadata(beam_altitude_angles=None),
        metadata(lidar_to_sensor_transform=[0, 0, 1, 0, 0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 0, 1]),
    ],
)
def test_metadata_that_lack_something_are_refused(text):
    with pytest.raises(MetadataError):
        OusterFormat(text)


def test_nested_metadata_of_newer_firmware():
    flat = json.loads(metadata())
    nested = {
        "beam_intrinsics": {k: flat[k] for k in ("beam_altitude_angles", "beam_azimuth_angles")},
        "lidar_intrinsics": {"lidar_to_sensor_transform": flat["lidar_to_sensor_transform"]},
        "lidar_data_format": flat["data_format"],
    }
    assert OusterFormat(json.dumps(nested)).packet_bytes == OusterFormat(metadata()).packet_bytes


def _ip(payload, port=2368, identity=1, offset=0, more=False):
    udp = struct.pack(">HHHH", 1, port, len(payload) + 8, 0) + payload if offset == 0 else payload
    flags = (0x2000 if more else 0) | offset // 8
    head = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(udp), identity, flags, 64, 17, 0, b"\x01" * 4, b"\x02" * 4)
    return bytes(12) + b"\x08\x00" + head + udp


def _pcap(*records, magic=b"\xd4\xc3\xb2\xa1", link=1):
    data = magic + struct.pack("<HHIIII", 2, 4, 0, 0, 65535, link)
    for k, record in enumerate(records):
        data += struct.pack("<IIII", 100 + k, 5, len(record), len(record)) + record
    return data


def test_a_capture_gives_payloads_ports_and_times():
    got = list(read_capture(io.BytesIO(_pcap(_ip(b"first"), _ip(b"second", port=7502)))))
    assert [(d.payload, d.port) for d in got] == [(b"first", 2368), (b"second", 7502)]
    assert got[0].stamp_ns == 100_000_005_000
    assert next(read_capture(io.BytesIO(_pcap(_ip(b"x"), magic=b"\x4d\x3c\xb2\xa1")))).stamp_ns == 100_000_000_005


def test_fragments_are_put_together_in_any_order():
    whole = bytes(range(256)) * 8
    udp = struct.pack(">HHHH", 1, 7502, len(whole) + 8, 0) + whole
    parts = [
        _ip(whole[: 1000 - 8], more=True),
        _ip(udp[1000:1800], offset=1000, more=True),
        _ip(udp[1800:], offset=1800),
    ]
    parts[0] = parts[0][:14] + parts[0][14:34] + udp[:1000]
    for order in ([0, 1, 2], [2, 0, 1]):
        got = list(read_capture(io.BytesIO(_pcap(*[parts[k] for k in order]))))
        assert [d.payload for d in got] == [whole]


@pytest.mark.parametrize("data", [b"", b"\x0a\x0d\x0d\x0a" + bytes(40), _pcap(link=147), bytes(100)])
def test_other_files_are_no_captures(data):
    with pytest.raises(CaptureError):
        list(read_capture(io.BytesIO(data)))


@settings(max_examples=60, deadline=None)
@given(cut=st.integers(0, 200), noise=st.binary(max_size=40))
def test_damaged_captures_end_or_are_refused(cut, noise):
    data = _pcap(_ip(b"first"), noise, _ip(b"second"))
    try:
        assert len(list(read_capture(io.BytesIO(data[:cut])))) <= 3
    except CaptureError:
        assert cut < 24


def test_a_scan_without_packets_is_no_damaged_bag():
    assert list(packets_of(SimpleNamespace(header=None, packets=[]), 7)) == []


def test_the_recorded_vls128_packets_decode_to_the_recorded_points(recording):
    folder = recording("lidar128-velodyne-vls128")
    with open_bag(folder / "vls128_packets.db3") as bag:
        messages = list(bag.messages("/velodyne_packets"))
    packets = [packet for stamp_ns, message in messages for packet in packets_of(message, stamp_ns)]
    parser = Vls128Parser(cut_deg=131.79)  # where the decoder that made scan_*.npz began
    fed = [parser.feed(packet, stamp_ns) for stamp_ns, packet in packets]
    revolutions = [revolution for revolution in fed if revolution is not None]
    assert parser.rejected == 0
    assert all(revolution.quality.complete and not revolution.quality.packets_lost for revolution in revolutions)
    ours = np.concatenate([revolution.points for revolution in revolutions])
    range_m = np.linalg.norm(ours[:, :3].astype(float), axis=1)
    ours = ours[(range_m > 0) & (range_m < 200.0005)]  # the other one drops what is farther
    scans = [np.load(folder / f"scan_{k}.npz") for k in range(3)]
    xyz, ring = (np.concatenate([scan[name] for scan in scans]) for name in ("xyz", "ring"))
    n = min(len(ours), len(xyz))
    assert n > 620_000
    assert np.array_equal(ours[:n, 4], ring[:n])
    apart = np.linalg.norm(ours[:n, :3] - xyz[:n], axis=1)
    assert np.median(apart) < 0.005
    assert (apart < 0.05).mean() > 0.999


def test_the_recorded_ouster_packets_decode_to_the_recorded_points(recording):
    folder = recording("lidar128-ouster-os2")
    layout = OusterFormat((folder / "OS-2-128.json").read_text())
    parser = OusterParser(layout)
    for datagram in read_capture(io.BytesIO((folder / "OS-2-128.pcap").read_bytes())):
        assert parser.feed(datagram.payload, datagram.stamp_ns) is None  # one revolution, closed by flush
    revolution = parser.flush()
    points = revolution.range_image.sample(1)
    with np.load(folder / "os2_128_0.npz") as file:
        mask = file["range_mm"] > 0
        beam, column = np.nonzero(mask)
        order = np.lexsort((beam, column))
        assert np.abs(points[:, :3] - file["xyz"][mask][order]).max() < 1e-3
        assert np.array_equal(points[:, 3], np.minimum(file["reflectivity"][mask][order], 255))
        assert np.array_equal(points[:, 4], 127 - beam[order])
    assert revolution.quality.complete
