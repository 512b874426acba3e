"""LD19 and STL-27L: the LD06's packets at other rates. The wrong rate is named; a clock of 1 ms is not loss."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import services.jetson.lidar.config as config_module
from common.bus.status import Report
from common.config import load
from services.jetson.lidar.config import LidarConfig
from services.jetson.lidar.decoder import ScanDecoder
from services.jetson.lidar.parser import PACKET_BYTES, POINTS
from services.jetson.lidar.pipeline import LidarPipeline
from spotter_sim import ld06

FOLDER = Path(config_module.__file__).parent
START_NS = 1_800_000_000_000_000_000


def stream(rate_hz: float, turns: int = 12) -> list[bytes]:
    """The packets of a sensor with ``rate_hz`` returns a second at 10 turns a second; a board 1 m ahead."""
    points = int(turns * rate_hz / 10) // POINTS * POINTS
    degrees = np.arange(points) * 3600.0 / rate_hz
    mm = np.where(np.cos(np.radians(degrees)) > 0.98, 1000, 2500)
    centi = np.round(degrees * 100).astype(int)
    return [
        ld06.encode_packet(
            int(centi[at]),
            int(centi[at + POINTS - 1]),
            mm[at : at + POINTS],
            np.full(POINTS, 200),
            int(1e3 * at / rate_hz),
        )
        for at in range(0, points, POINTS)
    ]


def read(packets: list[bytes], rate_hz: float, config: LidarConfig) -> tuple[list[str], list[str], Report]:
    """(levels, reasons of degraded turns, the report) of a service that gets these packets as they are sent."""
    report = Report("lidar")
    decoder, pipeline = ScanDecoder(config, report), LidarPipeline(config)
    levels, reasons = [], []
    for number, packet in enumerate(packets):
        arrival_s = (number + 1) * POINTS / rate_hz
        for scan in decoder.feed(START_NS + int(arrival_s * 1e9), arrival_s, packet):
            levels.append(pipeline.process(scan.stamp_ns, scan).level)
            if scan.state == "degraded":
                reasons.append(scan.reason)
    return levels, reasons, report


@pytest.mark.parametrize(("preset", "rate_hz"), [("ld19.toml", 4500.0), ("stl27l.toml", 21_600.0)])
def test_a_preset_reads_its_sensor(preset: str, rate_hz: float) -> None:
    config = load(LidarConfig, FOLDER / preset)
    levels, reasons, report = read(stream(rate_hz), rate_hz, config)
    assert len(levels) in (10, 11)
    assert levels[-1] == "CAUTION"
    assert not reasons
    assert report.snapshot().bad_input == 0


def test_lost_packets_of_a_fast_sensor_are_counted() -> None:
    config = load(LidarConfig, FOLDER / "stl27l.toml")
    kept = [packet for number, packet in enumerate(stream(21_600.0)) if not 900 <= number < 910]
    _, _, report = read(kept, 21_600.0, config)
    assert 8 <= report.snapshot().counters["lost_packets"] <= 12


def test_a_rate_set_too_low_is_named() -> None:
    _, reasons, _ = read(stream(21_600.0), 21_600.0, LidarConfig())
    assert reasons
    assert set(reasons) == {
        "the packets tell 21600 returns a second, [scan] sample_rate_hz says 4500: LD06 and LD19 give 4500, the "
        "STL-27L 21600 (services/jetson/lidar/stl27l.toml)"
    }


def test_a_rate_set_too_high_is_named() -> None:
    config = load(LidarConfig, FOLDER / "stl27l.toml")
    levels, _, report = read(stream(4500.0), 4500.0, config)
    assert not levels
    assert "do not fit [scan] sample_rate_hz = 21600: LD06 and LD19 give 4500" in report.snapshot().reason
    assert len(stream(4500.0)[0]) == PACKET_BYTES
