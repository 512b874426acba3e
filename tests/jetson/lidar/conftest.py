"""What the lidar's tests share: an independent slow decoder, real packets, real turns as bytes, scans to order."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from common.messages import LaserScan
from spotter_sim import ld06

SCAN_NS = 100_000_000  # one turn at 10 Hz
START_NS = 1_800_000_000_000_000_000


@pytest.fixture(scope="session")
def slow_crc() -> Callable[[bytes], int]:
    """CRC-8 0x4D bit by bit: no table, no linearity."""

    def crc(data: bytes) -> int:
        register = 0
        for byte in data:
            for bit in range(7, -1, -1):
                top = (register >> 7) ^ ((byte >> bit) & 1)
                register = (register << 1) & 0xFF
                if top:
                    register ^= 0x4D
        return register

    return crc


@pytest.fixture(scope="session")
def slow_parse(slow_crc: Callable[[bytes], int]) -> Callable[[bytes], list[bytes]]:
    """The obvious parser: try every byte, take a packet that checks, else go on by one byte."""

    def plausible(packet: bytes, sample_rate_hz: float) -> bool:
        speed = int.from_bytes(packet[2:4], "little")
        start, end = int.from_bytes(packet[4:6], "little"), int.from_bytes(packet[42:44], "little")
        fits = (end - start) % 36000 // 100 <= speed * 12 / sample_rate_hz * 1.5
        in_range = start < 36000 and end < 36000 and speed <= 7200
        return fits and in_range and int.from_bytes(packet[44:46], "little") <= 30000

    def parse(data: bytes, sample_rate_hz: float = 2300.0) -> list[bytes]:
        found, at = [], 0
        while at + 47 <= len(data):
            packet = data[at : at + 47]
            head = packet[0] == 0x54 and packet[1] == 0x2C
            if head and slow_crc(packet[:46]) == packet[46] and plausible(packet, sample_rate_hz):
                found.append(packet)
                at += 47
            else:
                at += 1
        return found

    return parse


@pytest.fixture
def real_packets(recordings: Callable[[str], Path]) -> list[bytes]:
    """Three packets that real devices sent."""
    lines = (recordings("ld06") / "packets.hex").read_text().splitlines()
    return [bytes.fromhex(line) for line in lines if line and not line.startswith("#")]


@pytest.fixture
def real_turns_m(recordings: Callable[[str], Path]) -> list[np.ndarray]:
    """Two real turns: (360,) metres at 1, 2, ... 360 degrees clockwise."""
    return [np.loadtxt(recordings("ld06") / f"scan_ranges_{number}.txt") for number in (0, 1)]


@pytest.fixture
def hokuyo_mm(recordings: Callable[[str], Path]) -> np.ndarray:
    """(756, 683) ranges in mm of a real drive, over 240 degrees from right to left; 0 = none."""
    with gzip.open(recordings("laser2d-urg04lx") / "exp1.dat.gz", "rt") as lines:
        return np.array([[int(v) for v in line.split()[24:]] for line in lines], dtype=np.int64)


@pytest.fixture
def stream_of() -> Callable[..., bytes]:
    """``stream_of(ranges_at, turns, ...)``: the bytes of some turns; ``ranges_at(angle_rad, turn)`` gives metres."""

    def stream(
        ranges_at: Callable[[np.ndarray, int], np.ndarray],
        turns: int = 3,
        speed_hz: float = 10.0,
        confidence: int = 200,
        start_ms: float = 0.0,
    ) -> bytes:
        points = int(turns * 4500 / speed_hz) // 12 * 12
        degrees = np.arange(points) * 360.0 * speed_hz / 4500
        turn = (degrees // 360).astype(int)
        mm = np.zeros(points, int)
        for number in range(turn[-1] + 1):
            here = turn == number
            mm[here] = np.round(1000 * ranges_at(-np.radians(degrees[here] % 360.0), number))
        return ld06.encode(degrees, mm, np.full(points, confidence), speed_dps=int(360 * speed_hz), start_ms=start_ms)

    return stream


@pytest.fixture
def scan_of() -> Callable[..., LaserScan]:
    """``scan_of(things, ...)``: a turn of beams. A thing is a board: (distance ahead, from y, to y) in metres."""

    def scan(
        things: list[tuple[float, float, float]],
        background_m: float = 0.0,
        number: int = 0,
        confidence: int = 200,
        beams: int = 450,
    ) -> LaserScan:
        angles = -np.pi + (np.arange(beams) + 0.5) * 2 * np.pi / beams
        ranges = np.full(beams, background_m)
        forward = np.abs(angles) < np.pi / 2 - 0.01
        for x_m, low_m, high_m in things:
            y = x_m * np.tan(np.where(forward, angles, 0.0))
            hit = forward & (y >= low_m) & (y <= high_m)
            distance = x_m / np.cos(np.where(forward, angles, 0.0))
            ranges = np.where(hit & ((ranges == 0) | (distance < ranges)), distance, ranges)
        return LaserScan(
            stamp_ns=START_NS + number * SCAN_NS,
            angles_rad=angles.astype(np.float32),
            ranges_m=np.round(ranges, 3).astype(np.float32),
            confidence=np.where(ranges > 0, confidence, 0).astype(np.uint8),
        )

    return scan
