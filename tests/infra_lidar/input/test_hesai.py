"""Hesai packets: against the emulator's own slow formulas, by model, layout, mode and unit; and nonsense."""

from __future__ import annotations

import types
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.infra_lidar.input.hesai import head, hesai_format
from services.infra_lidar.input.hesai_calibration import CalibrationError, as_metadata, read_calibration
from services.infra_lidar.input.hesai_parser import HesaiParser, crc32, crc32_mpeg2
from services.infra_lidar.input.revolution import decode_revolution, stack_packets
from services.infra_lidar.input.sensors import model_of
from services.infra_lidar.input.spinning import WRONG_WAY
from tests.infra_lidar.hesai_packets import (
    ANGLES,
    ELEVATIONS_DEG,
    OT128_FIRETIMES,
    PANDAR128_FIRETIMES,
    QT128_FIRETIMES,
    Packet,
    crc,
    points_of,
)

RNG = np.random.default_rng(3)
STEPS, REFLECTIVITY = RNG.integers(1, 50_000, (2, 128)), RNG.integers(0, 256, (2, 128))
BUSY = Packet(azimuth=(12345, 12365), steps=STEPS, reflectivity=REFLECTIVITY)
SAME = np.stack([STEPS[0], np.where(np.arange(128) % 2, STEPS[0], STEPS[1])])  # every second one has a single return


def ot128_s(row: int, state: int) -> float:
    loop = [(46.645, 34.067, 18.867, 6.289), (46.645, 34.067, 21.011, 6.289)][state][row % 4]
    return loop * 1e-6


def pandar_s(row: int, column: int) -> float:
    return (1000 * column + 100 * (row % 10)) * 1e-9


def qt_s(row: int, loop: int) -> float:
    return round((0.6, 1.2)[loop] + 0.7 * row, 3) * 1e-6


CASES = {  # name: (packet, firing times, firing time of (block, channel))
    "no firing times": (BUSY, "", lambda b, k: 0.0),
    "OT128 standard": (replace(BUSY, states=(0, 1)), OT128_FIRETIMES, lambda b, k: ot128_s(k, b)),
    "OT128 high resolution": (
        replace(BUSY, operation=0, states=(0, 2)),
        OT128_FIRETIMES,
        lambda b, k: ((18.867, 6.289, 18.867, 6.289), (18.867, 6.289, 21.011, 6.289))[b][k % 4] * 1e-6,
    ),
    "E3X standard": (replace(BUSY, states=(1, 0)), PANDAR128_FIRETIMES, lambda b, k: pandar_s(k, 5 - b)),
    "E3X energy saving": (replace(BUSY, operation=3), PANDAR128_FIRETIMES, lambda b, k: pandar_s(k, 6)),
    "E3X high": (replace(BUSY, operation=0, states=(3, 1)), PANDAR128_FIRETIMES, lambda b, k: pandar_s(k, (3, 1)[b])),
    "1200 rpm, 1 mm": (replace(BUSY, rpm=1200, unit_mm=1), PANDAR128_FIRETIMES, lambda b, k: pandar_s(k, 4)),
    "confidence, IMU": (replace(BUSY, confidence=True, imu=True), "", lambda b, k: 0.0),
    "bare": (replace(BUSY, sequence=None, safety_state=None), "", lambda b, k: 0.0),
    "signed": (replace(BUSY, signature=True), "", lambda b, k: 0.0),
    "QT128": (replace(BUSY, qt128=True), QT128_FIRETIMES, lambda b, k: qt_s(k, b)),
    "QT128 signed": (replace(BUSY, qt128=True, signature=True), QT128_FIRETIMES, lambda b, k: qt_s(k, b)),
    "dual": (replace(BUSY, mode=0x39, azimuth=(7, 7), steps=SAME), "", lambda b, k: 0.0),
    "QT128 dual": (
        replace(BUSY, qt128=True, mode=0x3B, azimuth=(7, 7), steps=SAME, mode_flag=2),
        QT128_FIRETIMES,
        lambda b, k: qt_s(k, 1),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_points_are_those_of_the_manuals_formulas(name: str, record_property: Callable[[str, object], None]) -> None:
    packet, firetimes, firetime_s = CASES[name]
    sensor = hesai_format(as_metadata(ANGLES, firetimes))
    raw = packet.build()
    assert sensor.head(raw) is not None
    image = decode_revolution(stack_packets([raw, raw]), sensor.decoder)
    expected = points_of(packet, np.array([[firetime_s(b, k) for k in range(128)] for b in range(2)]))
    if packet.mode >= 0x39:
        expected[1, packet.steps[1] == packet.steps[0]] = 0.0  # the same return is said twice
    points = image.points.reshape(2, 2, 128, 5)
    largest = np.abs(points[0, ..., :3] - expected).max()
    record_property("largest difference (mm)", float(1000 * largest))
    assert largest < 2e-4
    np.testing.assert_array_equal(points[0], points[1])
    returned = expected.any(axis=2)
    np.testing.assert_array_equal(points[0, ..., 3][returned], packet.reflectivity[returned])
    rings = np.argsort(np.argsort(ELEVATIONS_DEG))
    np.testing.assert_array_equal(points[0, 0, :, 4], rings)


def test_points_and_firing_times_are_those_of_an_independent_decoder(
    tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    other = pytest.importorskip("hydra4.decoders.pandar_ot128", reason="not installed: pip install hydra4==0.2.0")
    (tmp_path / "angles.csv").write_text(ANGLES)
    decoder = other.PandarOT128(tmp_path / "angles.csv", 0.0, 1000.0)
    message = types.SimpleNamespace(data=BUSY.build())
    theirs = np.array([[point[:3] for point in block.points] for block in decoder(message)])  # no firing times in them
    image = decode_revolution(stack_packets([BUSY.build()]), hesai_format(as_metadata(ANGLES)).decoder)
    largest = np.abs(image.points[:, :3].reshape(2, 128, 3) - theirs).max()
    record_property("largest difference (mm)", float(1000 * largest))
    assert largest < 2e-4
    rows = "".join(f"{k + 1},{a},{b}\n" for k, (a, b) in enumerate(other._FIRING_OFFSET_STANDARD))
    ours_us = read_calibration(ANGLES, rows).firetime_s * 1e6
    for k, states in enumerate(other._FIRING_OFFSET_HIGH_RES):  # the manual's table B.4
        assert all(offset_us is None or abs(ours_us[s, k] - offset_us) < 1e-6 for s, offset_us in enumerate(states))


def test_sizes_are_the_manuals() -> None:
    assert len(Packet(imu=True).build()) == 861  # OT128, 3.1.2
    assert len(Packet(imu=True, signature=True).build()) == 893  # Pandar128E3X, figure 3.1


@pytest.mark.parametrize("data", [b"", b"123456789", bytes(range(256))])
def test_check_sums_are_those_of_their_definition(data: bytes) -> None:
    assert (crc32(data), crc32_mpeg2(data)) == (crc(data, mpeg2=False), crc(data, mpeg2=True))


def test_check_sums_of_the_catalogue() -> None:
    assert (crc32(b"123456789"), crc32_mpeg2(b"123456789")) == (0xCBF43926, 0x0376E6E7)


def turn(count: int, **change: object) -> list[bytes]:
    """A revolution and the first packet of the next, as a sensor with that many packets per revolution sends it."""
    step = 36000 // count
    return [
        replace(Packet(sequence=k), azimuth=(step * k % 36000, (step * k + step // 2) % 36000), **change).build()  # type: ignore[arg-type]
        for k in range(count + 1)
    ]


def test_turns_losses_and_damage_are_told_apart() -> None:
    parser, packets = HesaiParser(as_metadata(ANGLES)), turn(60)
    broken = bytearray(packets[30])
    broken[100] ^= 4
    sent = [*packets[:10], *packets[11:20], packets[19], *packets[20:30], bytes(broken), *packets[31:]]
    (revolution,) = [done for k, packet in enumerate(sent) if (done := parser.feed(packet, k)) is not None]
    assert revolution.kind == "hesai"
    assert revolution.quality.packets_lost == 2
    assert parser.order.counters == {"packet doubled": 1, "packet damaged": 1}


def test_a_check_sum_that_was_never_right_is_not_believed() -> None:
    parser = HesaiParser(as_metadata(ANGLES))
    assert sum(parser.feed(packet, k) is not None for k, packet in enumerate(turn(60, checks=False))) == 1
    assert not parser.order.counters


def test_without_a_sequence_number_the_time_counts() -> None:
    parser = HesaiParser(as_metadata(ANGLES))
    packets = [
        Packet(sequence=None, azimuth=(40 * k, 40 * k + 20), microsecond=round(111.112 * k)).build() for k in range(30)
    ]
    for k, packet in enumerate([*packets[:7], *packets[9:]]):
        parser.feed(packet, k)
    revolution = parser.assembler.finish()
    assert revolution is not None
    assert revolution.quality.packets_lost == 2


def test_what_the_sensor_says_of_itself_is_counted_once() -> None:
    parser = HesaiParser(as_metadata(ANGLES))
    for k in range(5):
        parser.feed(Packet(sequence=k, safety_state=4).build(), k)
    assert parser.order.counters == {"sensor reports performance degradation": 1}


def test_another_layout_begins_another_turn() -> None:
    parser, packets = HesaiParser(as_metadata(ANGLES)), turn(60)
    mixed = [*packets[:30], *turn(60, confidence=True)[30:]]
    done = [revolution for k, packet in enumerate(mixed) if (revolution := parser.feed(packet, k)) is not None]
    assert [len(revolution.packets) for revolution in done] == [30, 30]


def test_a_qt128_with_selected_channels_is_no_guess() -> None:
    packet = bytearray(Packet(qt128=True).build())
    packet[11] |= 64
    assert head(bytes(packet)) is None
    assert model_of(bytes(packet)) == "Hesai QT with selected channels"


def test_a_head_that_turns_the_other_way_is_told() -> None:
    parser = HesaiParser(as_metadata(ANGLES))
    for k in range(450):
        parser.feed(Packet(sequence=k, azimuth=((36000 - 40 * k) % 36000, (35980 - 40 * k) % 36000)).build(), k)
    assert parser.order.counters == {WRONG_WAY: 2}


@pytest.mark.parametrize(
    "change",
    [{"azimuth": (36000, 0)}, {"azimuth": (0, 36000)}, {"mode": 0x32}, {"rpm": 0}, {"rpm": 9999}, {"unit_mm": 0}],
)
def test_what_no_sensor_says_is_no_packet(change: dict[str, object]) -> None:
    assert head(replace(BUSY, **change).build()) is None  # type: ignore[arg-type]


def test_in_high_resolution_packets_come_twice_as_often() -> None:
    steps_us = [
        found.step
        for operation in (0, 2)
        if (found := head(replace(BUSY, sequence=None, operation=operation).build())) is not None
    ]
    assert steps_us == pytest.approx([55.556, 111.112])


def test_firing_times_of_another_model_are_no_match() -> None:
    assert hesai_format(as_metadata(ANGLES, QT128_FIRETIMES)).head(Packet().build()) is None


@settings(max_examples=150, deadline=None)
@given(st.booleans(), st.integers(0, 1200), st.lists(st.tuples(st.integers(0, 860), st.integers(1, 255)), max_size=4))
def test_broken_packets_raise_nothing_and_are_no_far_points(
    qt128: bool, length: int, flips: list[tuple[int, int]]
) -> None:
    packet = bytearray(replace(BUSY, qt128=qt128).build()[:length])
    for at, bits in flips:
        if at < len(packet):
            packet[at] ^= bits
    parser = HesaiParser(as_metadata(ANGLES))
    parser.feed(replace(BUSY, qt128=qt128, sequence=0).build(), 0)
    parser.feed(bytes(packet), 1)
    revolution = parser.assembler.finish()
    assert revolution is not None
    if bytes(packet[12:784]) != replace(BUSY, qt128=qt128).build()[12:784]:  # within the body, whose check sum is known
        assert len(revolution.packets) == 1
    assert np.isfinite(revolution.points).all()
    assert np.linalg.norm(revolution.points[:, :3], axis=1).max() <= 65535 * 8e-3


FILES = [
    ("", "", "found 0"),
    ("Channel,Elevation,Azimuth\n" + "".join(f"{k},{k},0\n" for k in range(1, 41)), "", "128 channels, found 40"),
    (ANGLES.replace("14.4", "140.4"), "", "within 90"),
    ("".join(f"{k + 1},1.0,0\n" for k in range(128)), "", "a different elevation"),
    (ANGLES, ANGLES, "0 to 200 us"),
    (ANGLES, "1,2\n3,4\n", "3, 4 or 17 columns, found 0"),
    (ANGLES, "\n".join(QT128_FIRETIMES.splitlines()[:8]), "128 channels, found 5"),
    (ANGLES, QT128_FIRETIMES.replace("\n127,", "\n126,").replace(",127,", ",126,"), "128 channels, found 127"),
    (ANGLES, "\n".join(OT128_FIRETIMES.splitlines()[:100]), "128 channels, found 99"),
]


@pytest.mark.parametrize(("angles", "firetimes", "words"), FILES)
def test_calibrations_that_are_none(angles: str, firetimes: str, words: str) -> None:
    with pytest.raises(CalibrationError, match=words):
        read_calibration(angles, firetimes)


def test_firing_times_are_counted_from_0_or_1() -> None:
    from_0 = "".join(f"{k},{k / 10},{k / 20}\n" for k in range(128))
    from_1 = "".join(f"{k + 1},{k / 10},{k / 20}\n" for k in range(128))
    np.testing.assert_array_equal(
        read_calibration(ANGLES, from_0).firetime_s, read_calibration(ANGLES, from_1).firetime_s
    )
