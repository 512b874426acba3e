"""Packets -> revolutions: where they are cut, which way they turn, what a gap or a slow motor does."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from common.geometry import wrap_angle
from common.messages import LaserScan
from services.jetson.lidar.assembly import ScanAssembler, index_deg
from services.jetson.lidar.config import LidarConfig, MountingSection
from services.jetson.lidar.parser import PACKET_BYTES, Ld06Parser, Packet
from services.jetson.lidar.timing import DeviceClock

START_NS = 1_800_000_000_000_000_000
PACKET_NS = 8_000_000 / 3
Stream = Callable[..., bytes]


def assemble(data: bytes, config: LidarConfig | None = None) -> tuple[list[LaserScan], ScanAssembler]:
    config = config or LidarConfig()
    parser = Ld06Parser(config.scan.sample_rate_hz, config.mounting.clockwise)
    assembler = ScanAssembler(config)
    scans: list[LaserScan] = []
    for number, at in enumerate(range(0, len(data), PACKET_BYTES)):
        scans += assembler.add(parser.feed(data[at : at + PACKET_BYTES]), START_NS + int(number * PACKET_NS))
    return scans, assembler


def room(angle_rad: np.ndarray, _: int) -> np.ndarray:
    return 2.0 + 0.5 * np.cos(3 * angle_rad)


@pytest.mark.parametrize("speed_hz", [5.0, 6.3, 10.0, 13.0])
def test_one_scan_a_turn_at_every_speed(stream_of: Stream, speed_hz: float) -> None:
    scans, assembler = assemble(stream_of(room, turns=6, speed_hz=speed_hz))
    assert len(scans) in (5, 6)
    for scan in scans:
        assert abs(len(scan.angles_rad) - 4500 / speed_hz) <= 1
        np.testing.assert_allclose(scan.ranges_m, room(scan.angles_rad, 0), atol=2e-3)
        assert scan.state == "online"
    gaps_ns = np.diff([scan.stamp_ns for scan in scans])
    np.testing.assert_allclose(gaps_ns * 1e-9, 1 / speed_hz, atol=1.5e-3)
    assert assembler.counters["partial_scans"] == 1
    assert assembler.counters["lost_packets"] == assembler.counters["overlong_scans"] == 0


def test_a_scan_ends_just_behind_the_forward_cone(stream_of: Stream) -> None:
    scans, _ = assemble(stream_of(room, turns=3))
    degrees = np.degrees(scans[0].angles_rad)
    assert degrees[-1] == pytest.approx(-25.0, abs=0.9)  # sweeping clockwise, the cone ends at -20
    assert degrees[0] == pytest.approx(-25.0, abs=0.9)
    in_cone = np.abs(degrees) <= 20.0
    assert np.flatnonzero(in_cone).min() > len(degrees) - 60  # the whole cone is the newest part of the scan


@pytest.mark.parametrize(
    ("mounting", "sensor_deg_of_left"),
    [
        (MountingSection(), 270.0),  # the sensor counts clockwise: 270 degrees is the left
        (MountingSection(upside_down=True), 90.0),
        (MountingSection(yaw_deg=180.0), 90.0),  # mounted backwards
        (MountingSection(yaw_deg=90.0), 0.0),  # its arrow points to the left
        (MountingSection(clockwise=False), 90.0),
        (MountingSection(clockwise=False, upside_down=True), 270.0),
        (MountingSection(upside_down=True, yaw_deg=180.0), 270.0),
    ],
)
def test_left_is_left(stream_of: Stream, mounting: MountingSection, sensor_deg_of_left: float) -> None:
    """A post one metre to the left of the vehicle comes out at +90 degrees, however the sensor is mounted."""
    config = LidarConfig(mounting=mounting)

    def post(angle_rad: np.ndarray, _: int) -> np.ndarray:
        away = np.abs(wrap_angle(-angle_rad - np.radians(sensor_deg_of_left)))
        return np.where(away < np.radians(3.0), 1.0, 3.0)

    scans, _ = assemble(stream_of(post, turns=3), config)
    near = scans[0].ranges_m < 2.0
    assert np.degrees(scans[0].angles_rad[near].mean()) == pytest.approx(90.0, abs=0.5)
    # Wherever the sensor points, the scan ends just behind the cone in front of the vehicle
    assert abs(np.degrees(scans[0].angles_rad[-1])) == pytest.approx(25.0, abs=0.9)


def test_index_is_in_the_sensors_own_degrees() -> None:
    assert index_deg(LidarConfig()) == 25.0
    assert index_deg(LidarConfig(mounting=MountingSection(yaw_deg=180.0))) == 205.0


def test_both_real_turns_come_back_as_they_went_in(real_turns_m: list[np.ndarray], stream_of: Stream) -> None:
    for turn_m in real_turns_m:
        turn = np.roll(turn_m, 1)  # line 1 is at 1 degree

        def ranges_at(angle_rad: np.ndarray, _: int, turn: np.ndarray = turn) -> np.ndarray:
            return turn[np.floor(np.degrees(-angle_rad) + 1e-9).astype(int) % 360]

        scans, _ = assemble(stream_of(ranges_at, turns=3))
        degrees = np.degrees(-scans[0].angles_rad.astype(float)) % 360.0
        firm = np.abs(degrees - np.round(degrees)) > 0.02  # not on the edge between two of the recording's degrees
        np.testing.assert_array_equal(scans[0].ranges_m[firm], turn[np.floor(degrees[firm]).astype(int)].astype("f4"))
        assert len(np.unique(np.floor(degrees))) == 360


def test_lost_packets_are_counted_and_the_turn_survives(stream_of: Stream) -> None:
    data = stream_of(room, turns=5)
    packets = [data[at : at + PACKET_BYTES] for at in range(0, len(data), PACKET_BYTES)]
    kept = [packet for number, packet in enumerate(packets) if number not in (50, 51, 90)]
    scans, assembler = assemble(b"".join(kept))
    assert assembler.counters["gaps"] == 2
    assert assembler.counters["lost_packets"] == 3
    assert sorted(450 - len(scan.angles_rad) for scan in scans) == [0, 0, 12, 24][-len(scans) :]


def test_a_gap_over_the_index_closes_the_turn(stream_of: Stream) -> None:
    data = stream_of(room, turns=5)
    packets = [data[at : at + PACKET_BYTES] for at in range(0, len(data), PACKET_BYTES)]
    index_packet = 2 + 2 * 37 + 2  # near 25 degrees in the third turn
    scans, _ = assemble(b"".join(packets[: index_packet - 5] + packets[index_packet + 10 :]))
    assert len(scans) == 4
    assert all(len(scan.angles_rad) <= 450 for scan in scans)


def test_more_than_half_a_turn_missing_starts_anew(stream_of: Stream) -> None:
    data = stream_of(room, turns=8)
    packets = [data[at : at + PACKET_BYTES] for at in range(0, len(data), PACKET_BYTES)]
    scans, assembler = assemble(b"".join(packets[:100] + packets[180:]))
    assert all(len(scan.angles_rad) <= 450 for scan in scans)
    assert assembler.counters["partial_scans"] == 2
    assert [len(scan.angles_rad) for scan in scans[-2:]] == [450, 450]


def test_spin_up_from_standstill_is_degraded_until_it_turns(stream_of: Stream) -> None:
    still = [packet_of(0.0, 0.0, 0, ms) for ms in np.arange(0, 1500, 8 / 3)]
    angle, ramp, ms = 0.0, [], 1500.0
    for hz in np.linspace(0.1, 10.0, 600):
        span = hz * 360 * 12 / 4500
        ramp.append(packet_of(angle, span * 11 / 12, int(hz * 360), ms))
        angle, ms = angle + span, ms + 8 / 3
    steady = []
    for _ in range(150):
        steady.append(packet_of(angle, 8.8, 3600, ms))
        angle, ms = angle + 9.6, ms + 8 / 3
    assembler = ScanAssembler(LidarConfig())
    scans = []
    for number, packet in enumerate([*still, *ramp, *steady]):
        scans += assembler.add([packet], START_NS + int(number * PACKET_NS))
    states = [scan.state for scan in scans]
    assert states[0] == "degraded"
    assert "stalled: 0.0 turns" in scans[0].reason
    assert states[-3:] == ["online"] * 3
    assert np.diff([scan.stamp_ns for scan in scans]).max() < 0.45e9  # never silent while packets come
    assert not any(len(scan.angles_rad) > 2000 for scan in scans)


def test_a_sensor_that_lost_its_index_gives_no_overlong_turns() -> None:
    """Jittering around one place below the index: nothing closes, so time does, and the motor is blamed."""
    assembler = ScanAssembler(LidarConfig())
    scans = []
    for number in range(1000):
        packet = packet_of(100.0 + 5 * (number % 2), 8.8, 3600, number * 8 / 3)
        scans += assembler.add([packet], START_NS + int(number * PACKET_NS))
    assert scans
    assert {scan.state for scan in scans} == {"degraded"}


def test_packets_to_index_counts_down(stream_of: Stream) -> None:
    data = stream_of(room, turns=3)
    parser, assembler = Ld06Parser(), ScanAssembler(LidarConfig())
    wanted = []
    for at in range(0, len(data), PACKET_BYTES):
        closed = bool(assembler.add(parser.feed(data[at : at + PACKET_BYTES]), START_NS))
        if closed and wanted:
            assert wanted[-1] == 1  # the packet that closed the turn was the one waited for
        wanted.append(assembler.packets_to_index())
    assert max(wanted) <= 38


def packet_of(start_deg: float, span_deg: float, speed_dps: int, ms: float) -> Packet:
    angles = -np.radians(start_deg % 360 + span_deg * np.arange(12) / 11)
    return Packet(
        speed_dps=speed_dps,
        start_deg=start_deg % 360,
        end_deg=(start_deg + span_deg) % 360,
        timestamp_ms=int(ms) % 30_000,
        angles_rad=angles,
        distances_mm=np.full(12, 1000, np.uint16),
        confidence=np.full(12, 200, np.uint8),
    )


class TestDeviceClock:
    def test_wraps_at_30000_and_skips_whole_wraps(self) -> None:
        clock = DeviceClock()
        assert clock.advance(29_990, START_NS)[0] == 0
        assert clock.advance(10, START_NS + 20_000_000)[0] == 20
        assert clock.advance(20, START_NS + 20_000_000 + 60_010_000_000)[0] == 60_030  # two whole wraps unseen
        assert clock.restarts == 0

    def test_removes_the_jitter_of_arrival(self) -> None:
        rng = np.random.default_rng(3)
        clock = DeviceClock()
        errors_ms = []
        for ms in range(0, 20_000, 8):
            late_ns = int(rng.exponential(4e6))
            _, utc = clock.advance(ms, START_NS + ms * 1_000_000 + late_ns)
            errors_ms.append((utc - START_NS) / 1e6 - ms)
        assert max(errors_ms[200:]) < 0.5  # arrivals are 4 ms late on average and 30 ms at worst
        assert min(errors_ms) >= 0.0

    def test_a_restarted_sensor_is_noticed(self) -> None:
        clock = DeviceClock()
        clock.advance(20_000, START_NS)
        device_ms, utc = clock.advance(3, START_NS + 5_000_000)
        assert clock.restarts == 1
        assert utc == START_NS + 5_000_000
        assert clock.advance(6, START_NS + 8_000_000)[0] == device_ms + 3

    @pytest.mark.parametrize("ahead_s", [0.2, 0.5, 0.9])
    @pytest.mark.parametrize("over_s", [0.0, 10.0])  # at once, or slewed, as chrony does after the start
    def test_a_clock_that_is_set_forward_is_followed_within_seconds(self, ahead_s: float, over_s: float) -> None:
        """By the drift of two crystals alone, scans would be dated half a second back for an hour and a half."""
        rng, clock, off_ms = np.random.default_rng(3), DeviceClock(), []
        for ms in range(0, 40_000, 8):
            share = np.clip((ms / 1e3 - 10.0) / over_s, 0.0, 1.0) if over_s else float(ms >= 10_000)
            true_ns = START_NS + ms * 1_000_000 + round(share * ahead_s * 1e9)
            _, utc = clock.advance(ms % 30_000, true_ns + int(rng.exponential(4e6)))
            off_ms.append((utc - true_ns) / 1e6)
        assert max(off_ms) < 30.0
        assert abs(off_ms[-1]) < 60.0
        assert clock.restarts == 0
