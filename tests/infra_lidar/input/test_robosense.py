"""RoboSense packets: against the emulator's slow formulas, the manuals' worked examples, and nonsense."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.infra_lidar.input.hesai_calibration import CalibrationError
from services.infra_lidar.input.models import KINDS
from services.infra_lidar.input.revolution import decode_revolution, stack_packets
from services.infra_lidar.input.robosense import (
    as_metadata,
    read_angle_file,
    read_difop,
    robosense_format,
    unknown_angles,
)
from services.infra_lidar.input.sensors import model_of
from tests.infra_lidar.robosense_packets import HORIZONTAL_DEG, VERTICAL_DEG, Msop, difop, point_of

METADATA = as_metadata(read_difop(difop()))
RNG = np.random.default_rng(5)
BUSY = Msop(steps=RNG.integers(1, 50_000, (3, 128)), reflectivity=RNG.integers(0, 256, (3, 128)))
SPEED = {600: 20, 1200: 40, 300: 10}  # rpm: 0.01 degrees in a block of 55.56 us


@pytest.mark.parametrize("rpm", SPEED)
@pytest.mark.parametrize("plus", [False, True])
def test_points_are_those_of_the_plain_formulas(
    plus: bool, rpm: int, record_property: Callable[[str, object], None]
) -> None:
    step = SPEED[rpm]
    packet = replace(BUSY, plus=plus, azimuth=(35990, (35990 + step) % 36000, (35990 + 2 * step) % 36000))
    image = decode_revolution(stack_packets([packet.build()]), robosense_format(METADATA).decoder)
    points = image.points.reshape(3, 128, 5)
    largest = 0.0
    for block in range(3):
        for channel in (0, 4, 31, 64, 100, 127):
            expected = point_of(packet, block, channel, step / 100.0 / 55.56e-6)
            largest = max(largest, np.abs(points[block, channel, :3] - expected).max())
    record_property("largest difference (mm)", float(1000 * largest))
    assert largest < 2e-4
    np.testing.assert_array_equal(points[..., 3], packet.reflectivity)
    np.testing.assert_array_equal(points[0, :, 4], np.arange(128))  # the lowest beam is ring 0


def test_two_returns_lie_on_the_beams_of_one() -> None:
    packets = [
        replace(BUSY, dual=True, azimuth=(0, 0, 20)).build(),
        replace(BUSY, dual=True, azimuth=(20, 40, 40), steps=BUSY.steps + 7).build(),
    ]
    points = decode_revolution(stack_packets(packets), robosense_format(METADATA).decoder).points.reshape(6, 128, 5)
    one = replace(BUSY, azimuth=(0, 20, 40), steps=np.stack([BUSY.steps[0], BUSY.steps[2], BUSY.steps[1] + 7]))
    for channel in (0, 4, 31, 64, 127):
        for block, row in ((0, 0), (1, 2), (2, 4)):
            expected = point_of(one, block, channel, 0.2 / 55.56e-6)
            assert np.abs(points[row, channel, :3] - expected).max() < 2e-4


def test_the_manuals_worked_examples() -> None:
    steps = np.full((3, 128), 0x084B)
    packet = replace(BUSY, steps=steps, azimuth=(0x5939 - 20, 0x5939, 0x5939 + 20)).build()
    found = robosense_format(METADATA).head(packet)
    assert found is not None
    assert found.first_deg == pytest.approx(228.41 - 0.2)
    image = decode_revolution(stack_packets([packet]), robosense_format(METADATA).decoder)
    assert image.range_m == pytest.approx(10.615)
    raw = bytearray(difop())
    raw[468:471], raw[852:855] = b"\x01\x05\x4c", b"\x01\x02\x53"
    angles = read_difop(bytes(raw))
    assert (angles.vertical_deg[0], angles.horizontal_deg[0]) == (-13.56, -5.95)


def test_difop_angles_survive_the_way_through_a_recording() -> None:
    angles = read_difop(difop())
    np.testing.assert_array_equal(angles.vertical_deg, VERTICAL_DEG)
    np.testing.assert_array_equal(angles.horizontal_deg, HORIZONTAL_DEG)
    lines = "".join(f"{v},{h}\n" for v, h in zip(VERTICAL_DEG, HORIZONTAL_DEG, strict=True))
    assert as_metadata(read_angle_file(lines)) == as_metadata(angles)


def test_a_second_return_at_the_same_range_is_none_also_across_packets() -> None:
    steps = np.full((3, 128), 2000)
    other = steps.copy()
    other[1, ::2] = 4000
    packets = [
        Msop(dual=True, azimuth=(0, 0, 20), steps=other).build(),
        Msop(dual=True, azimuth=(20, 40, 40), steps=steps).build(),
    ]
    image = decode_revolution(stack_packets(packets), robosense_format(METADATA).decoder)
    assert [int(np.count_nonzero(row)) for row in image.range_m] == [128, 64, 128, 0, 128, 0]


def turn(dual: bool = False) -> list[bytes]:
    """One turn at 3600 degrees a second, and the first packet of the next; coarse: 60 packets."""
    step_us = 55.56 * (1.5 if dual else 3.0)
    places = [(600 * k % 36000, (600 * k + 20) % 36000, (600 * k + (20 if dual else 40)) % 36000) for k in range(61)]
    return [Msop(azimuth=at, microsecond=round(step_us * k), dual=dual).build() for k, at in enumerate(places)]


@pytest.mark.parametrize("dual", [False, True])
def test_turns_and_losses(dual: bool) -> None:
    parser, packets = KINDS["robosense"].parser(METADATA, 0.0), turn(dual)
    sent = [*packets[:10], *packets[12:20], packets[19], *packets[20:]]
    (revolution,) = [done for k, packet in enumerate(sent) if (done := parser.feed(packet, k)) is not None]
    assert revolution.quality.packets_lost == 2
    assert revolution.kind == "robosense"
    assert parser.order.counters == {"packet doubled": 1}


def test_a_time_stamp_in_nanoseconds_is_understood() -> None:
    packet = bytearray(Msop(microsecond=500).build())
    packet[16:20] = struct.pack(">I", 500_000_000)
    found = robosense_format(METADATA).head(bytes(packet))
    assert found is not None
    assert found.position % 1_000_000 == 500_000


def test_models_are_told_apart() -> None:
    assert model_of(Msop().build()) == "RoboSense Ruby"
    assert model_of(Msop(plus=True).build()) == "RoboSense Ruby Plus"
    other = bytearray(Msop().build())
    other[468] = 0
    assert model_of(bytes(other)) == "RoboSense (RS-80 or Helios kind)"
    assert model_of(difop()) == ""


@pytest.mark.parametrize(
    ("packet", "words"),
    [
        (Msop().build(), "not a DIFOP"),
        (difop()[:-1], "not a DIFOP"),
        (difop(np.zeros(128)), "a different vertical angle"),
        (difop(np.full(128, -300.0)), "within 45 degrees"),
    ],
)
def test_angles_that_are_none(packet: bytes, words: str) -> None:
    with pytest.raises(CalibrationError, match=words):
        read_difop(packet)


@pytest.mark.parametrize(("text", "words"), [("", "found 0"), ("1,2\n", "found 1"), ("a,b\n", "lines of vertical")])
def test_angle_files_that_are_none(text: str, words: str) -> None:
    with pytest.raises(CalibrationError, match=words):
        read_angle_file(text)


@pytest.mark.parametrize("metadata", ["", "{}", '{"vertical_deg": [1], "horizontal_deg": [1]}', "[]"])
def test_metadata_that_are_none(metadata: str) -> None:
    with pytest.raises(CalibrationError):
        robosense_format(metadata)


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 1400), st.lists(st.tuples(st.integers(0, 1247), st.integers(1, 255)), max_size=4))
def test_broken_packets_raise_nothing_and_are_no_far_points(length: int, flips: list[tuple[int, int]]) -> None:
    packet = bytearray(BUSY.build()[:length])
    for at, bits in flips:
        if at < len(packet):
            packet[at] ^= bits
    parser = KINDS["robosense"].parser(unknown_angles(), 0.0)
    parser.feed(BUSY.build(), 0)
    parser.feed(bytes(packet), 1)
    revolution = parser.assembler.finish()
    assert revolution is not None
    assert len(revolution.packets) == 1 or len(packet) == 1248
    assert np.isfinite(revolution.points).all()
    assert np.linalg.norm(revolution.points[:, :3], axis=1).max() <= 65535 * 0.005 + 0.1
