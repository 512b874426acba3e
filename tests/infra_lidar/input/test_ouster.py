"""Ouster packets in every profile: against slow plain formulas, ouster-sdk where it is installed, and nonsense."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.infra_lidar.input.ouster import OusterFormat, OusterParser, decode
from services.infra_lidar.input.ouster_metadata import MetadataError
from services.infra_lidar.input.ouster_profiles import PROFILES
from services.infra_lidar.input.revolution import Revolution
from tests.infra_lidar.ouster_packets import COLUMNS, FIELDS, Frame, metadata, point_of

RNG = np.random.default_rng(9)


def frame(profile: str, **change: object) -> Frame:
    """A turn of random ranges; every third second return is the first one again."""
    fields = FIELDS[profile][1]
    returns = 2 if "range2" in fields else 1
    ranges = RNG.integers(100, 1 << min(fields["range"][1], 17), (returns, 128, COLUMNS))
    if returns == 2:
        ranges[1, ::3] = ranges[0, ::3]
    reflectivity = RNG.integers(0, 256, ranges.shape)
    return Frame(profile, ranges, reflectivity, **change)  # type: ignore[arg-type]


def turn_of(sent: Frame) -> Revolution:
    parser = OusterParser(OusterFormat(metadata(sent.profile)))
    for k, packet in enumerate(sent.packets()):
        assert parser.accepts(packet)
        assert parser.feed(packet, k) is None
    revolution = parser.flush()
    assert revolution is not None
    return revolution


def expected_m(sent: Frame) -> np.ndarray:
    """(returns, 128, COLUMNS) m; a second return that is the first again is 0."""
    range_m = sent.ranges * FIELDS[sent.profile][2] / 1000.0
    if len(range_m) == 2:
        range_m[1, sent.ranges[1] == sent.ranges[0]] = 0.0
    return range_m


def by_pixel(revolution: Revolution, returns: int) -> np.ndarray:
    """(returns, 128, COLUMNS, 5): the points, in the order of the packets."""
    return revolution.points.reshape(COLUMNS, returns, 128, 5).transpose(1, 2, 0, 3)


def test_every_profile_is_in_the_table() -> None:
    assert set(FIELDS) == set(PROFILES)


@pytest.mark.parametrize("profile", FIELDS)
def test_ranges_and_points_are_those_of_the_manual(profile: str) -> None:
    sent = frame(profile)
    revolution = turn_of(sent)
    range_m = expected_m(sent)
    returns = len(range_m)
    measured = revolution.range_image.range_m.reshape(COLUMNS, returns, 128).transpose(1, 2, 0)
    np.testing.assert_allclose(measured, range_m, rtol=1e-6)
    points = by_pixel(revolution, returns)
    returned = range_m > 0.0
    np.testing.assert_array_equal(points[..., 3][returned], sent.reflectivity[returned])
    for k in range(200):
        one, beam, column = k % returns, int(RNG.integers(128)), int(RNG.integers(COLUMNS))
        if returned[one, beam, column]:
            expected = point_of(column, beam, range_m[one, beam, column])
            assert np.abs(points[one, beam, column, :3] - expected).max() < 2e-4
            assert points[one, beam, column, 4] == 127 - beam
    assert revolution.quality.complete
    assert revolution.kind == "ouster"


def test_a_reflectivity_of_16_bits_is_cut_at_255() -> None:
    layout = OusterFormat(metadata("LEGACY"))
    packet = bytearray(frame("LEGACY").packet(0))
    packet[16 + 4 : 16 + 6] = (300).to_bytes(2, "little")  # of the first pixel
    assert decode(layout, np.frombuffer(bytes(packet), np.uint8)[None]).intensity[0, 0] == 255


@pytest.mark.parametrize("profile", ["LEGACY", "RNG15_RFL8_NIR8_DUAL", "FUSA_RNG15_RFL8_NIR8_DUAL"])
def test_columns_outside_the_window_are_no_points_and_no_loss(profile: str) -> None:
    sent = frame(profile, dead_columns=frozenset([*range(100), *range(300, COLUMNS)]))
    window = [packet for first, packet in enumerate(sent.packets()) if 96 <= 16 * first < 304]
    parser = OusterParser(OusterFormat(metadata(profile, (100, 299))))
    turns = []
    for turn in range(4):
        for packet in window:
            at = {"LEGACY": 10}.get(profile, 4 if profile.startswith("FUSA") else 2)
            changed = bytearray(packet)
            changed[at : at + 2] = (7 + turn).to_bytes(2, "little")
            done = parser.feed(bytes(changed), turn)
            turns += [done] if done else []
    assert [turn.quality.packets_lost for turn in turns[1:]] == [0, 0]
    assert turns[-1].quality.complete
    assert len(turns[-1].range_image.range_m) == 200 * (1 + ("DUAL" in profile))


@pytest.mark.parametrize("profile", FIELDS)
def test_points_are_those_of_the_vendors_library(profile: str, record_property: Callable[[str, object], None]) -> None:
    core = pytest.importorskip("ouster.sdk.core", reason="ouster-sdk is not installed: pip install ouster-sdk==1.0.1")
    sent = frame(profile)
    info = core.SensorInfo(metadata(profile))
    layout = core.PacketFormat.from_info(info)
    lut = core.XYZLut(info)
    range_mm = np.zeros((2, 128, COLUMNS), np.uint32)
    for number, packet in enumerate(sent.packets()):
        assert len(packet) == layout.lidar_packet_size
        theirs = core.LidarPacket(layout)
        theirs.buf[:] = np.frombuffer(packet, np.uint8)
        places = slice(16 * number, 16 * number + 16)
        for one, name in enumerate(("RANGE", "RANGE2")[: len(sent.ranges)]):
            range_mm[one, :, places] = layout.packet_field(name, theirs.buf)
    points = by_pixel(turn_of(sent), len(sent.ranges))
    for one in range(len(sent.ranges)):
        xyz, ours = lut(range_mm[one]), points[one, ..., :3]
        returned = np.any(ours != 0.0, axis=2)
        assert returned.mean() > 0.5
        largest = np.abs(ours - xyz)[returned].max()
        record_property(f"return {one + 1}, largest difference (mm)", float(1000 * largest))
        assert largest < 2e-4


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("columns_per_frame", 0, "columns_per_frame 0: expected 1 or more"),
        ("columns_per_frame", -512, "columns_per_frame -512: expected 1 or more"),
        ("columns_per_frame", 8, "columns_per_frame 8: expected a multiple of columns_per_packet, which is 16"),
        ("columns_per_frame", 1000, "columns_per_frame 1000: expected a multiple of columns_per_packet, which is 16"),
        ("columns_per_frame", float("inf"), "not the metadata of an Ouster lidar"),
        ("columns_per_packet", 0, "columns_per_packet 0: expected 1 or more"),
        ("columns_per_packet", -16, "columns_per_packet -16: expected 1 or more"),
        ("columns_per_packet", 1024, "columns_per_frame 512: expected a multiple of columns_per_packet, which is 1024"),
        ("pixels_per_column", 0, "pixels_per_column 0: expected a number that divides 128"),
        ("pixels_per_column", 48, "pixels_per_column 48: expected a number that divides 128"),
        ("pixels_per_column", 256, "pixels_per_column 256: expected a number that divides 128"),
    ],
)
def test_metadata_that_cannot_be_used_are_refused(name: str, value: float, words: str) -> None:
    document = json.loads(metadata("RNG19_RFL8_SIG16_NIR16"))
    document["lidar_data_format"][name] = value
    beams = document["lidar_data_format"]["pixels_per_column"]
    for angles in ("beam_altitude_angles", "beam_azimuth_angles"):
        document["beam_intrinsics"][angles] = [0.0] * beams
    with pytest.raises(MetadataError, match=words):
        OusterFormat(json.dumps(document))


@settings(max_examples=100, deadline=None)
@given(
    st.sampled_from(sorted(FIELDS)),
    st.integers(0, 45_000),
    st.lists(st.tuples(st.integers(0, 9000), st.integers(1, 255))),
)
def test_broken_packets_raise_nothing(profile: str, length: int, flips: list[tuple[int, int]]) -> None:
    layout = OusterFormat(metadata(profile))
    packet = bytearray(layout.packet_bytes if length % 3 else length)
    packet[: len(layout.packet_type)] = layout.packet_type
    for at, bits in flips:
        if at < len(packet):
            packet[at] ^= bits
    parser = OusterParser(layout)
    parser.feed(bytes(packet), 1)
    revolution = parser.flush()
    if revolution is not None:
        assert len(packet) == layout.packet_bytes
        assert np.isfinite(revolution.points).all()
        assert np.linalg.norm(revolution.points[:, :3], axis=1).max(initial=0.0) <= (1 << 20) / 1000.0 + 0.1
