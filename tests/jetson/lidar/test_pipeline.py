"""Bytes in, zones out: against the simulated world's truth, and on a real drive."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from common.bus.status import Report
from common.codec import decode, encode
from common.config import ConfigError
from common.messages import LEVELS, LaserScan, LidarZones
from services.jetson.lidar.config import LidarConfig, PersistenceSection
from services.jetson.lidar.decoder import ScanDecoder
from services.jetson.lidar.parser import PACKET_BYTES
from services.jetson.lidar.pipeline import LidarPipeline
from services.jetson.lidar.plot import draw, plot_scans
from spotter_sim import ld06
from spotter_sim.truth import LIDAR_BANDS_M, band, lidar_zones
from spotter_sim.world import SCENARIOS, world_at

START_NS = 1_800_000_000_000_000_000
BYTE_S = 8e-3 / 3 / PACKET_BYTES


def replay(data: bytes, pipeline: LidarPipeline | None = None) -> list[tuple[float, LidarZones, LaserScan]]:
    """(seconds since the start, zones, scan) for each turn in the bytes."""
    decoder, pipeline = ScanDecoder(LidarConfig(), Report("test")), pipeline or LidarPipeline(LidarConfig())
    seen = []
    for at in range(0, len(data), 8 * PACKET_BYTES):
        piece = data[at : at + 8 * PACKET_BYTES]
        arrival_s = (at + len(piece)) * BYTE_S
        for scan in decoder.feed(START_NS + int(arrival_s * 1e9), arrival_s, piece):
            zones = pipeline.process(scan.stamp_ns, scan)
            seen.append(((scan.stamp_ns - START_NS) * 1e-9, zones, scan))
    return seen


def test_crossing_agrees_with_the_truth() -> None:
    """Our lanes are wider than the truth's strips, so nothing is seen later, and what is reported is there."""
    length_s = SCENARIOS["crossing"].length_s
    truth = [lidar_zones(world_at("crossing", t)).nearest_m for t in np.arange(0.0, length_s, 0.25)]
    seen = replay(ld06.packets("crossing", 0.0, length_s))
    for at_s, zones, _ in seen:
        assert zones.state == "online"
        # What has held for more than half a second has to be said: 3 scans to raise, 1 turn to sweep
        held = [band(nearest, LIDAR_BANDS_M) for nearest in truth[max(0, int(at_s * 4) - 2) : int(at_s * 4) + 1]]
        if at_s > 0.8:
            assert LEVELS.index(zones.level) >= min(LEVELS.index(level) for level in held), at_s
    assert {zones.level for _, zones, _ in seen} == set(LEVELS)
    standing = [zones for at_s, zones, _ in seen if 5.5 < at_s < 6.4]
    nearest = [min(z.nearest_m for z in (o.left, o.centre, o.right) if z.nearest_m is not None) for o in standing]
    assert np.median(nearest) <= truth[24] + 0.03


def test_a_turn_is_published_by_the_packet_that_closes_it() -> None:
    decoder = ScanDecoder(LidarConfig(), Report("test"))
    data = ld06.packets("crossing", 0.0, 1.0)
    for number, at in enumerate(range(0, len(data), PACKET_BYTES)):
        last_packet = data[at : at + PACKET_BYTES]
        decoder.wanted_s()
        for scan in decoder.feed(START_NS + int(number * 8e6 / 3), 0.0, last_packet):
            # The newest return is less than one packet old when the packet is there
            assert 0 <= START_NS + int(number * 8e6 / 3) - scan.stamp_ns < 4_000_000


def test_zones_travel(scan_of: Callable[..., LaserScan]) -> None:
    pipeline = LidarPipeline(LidarConfig())
    zones = [pipeline.process(n * 10**8 + START_NS, scan_of([(0.5, -0.1, 0.1)], 3.0)) for n in range(4)][-1]
    assert decode(encode(zones), LidarZones) == zones
    assert (zones.level, zones.raw_level, zones.frame_id) == ("IMMINENT", "IMMINENT", "lidar")
    assert zones.scan_hz == pytest.approx(10.0)
    assert zones.centre.points > 10
    assert zones.layout is not None
    assert zones.layout.centre_width_m == LidarConfig().zones.centre_width_m


def test_raw_level_flickers_and_level_does_not(scan_of: Callable[..., LaserScan]) -> None:
    pipeline = LidarPipeline(LidarConfig())
    results = []
    for number in range(12):
        things = [(0.5, -0.1, 0.1)] if number % 2 else []
        results.append(pipeline.process(START_NS + number * 10**8, scan_of(things, 2.5)))
    assert [zones.raw_level for zones in results] == ["SAFE", "IMMINENT"] * 6
    assert {zones.level for zones in results} == {"SAFE"}
    # The distance that goes with SAFE is the wall's, never the ghost's
    assert {zones.centre.nearest_m for zones in results[3:]} == {2.497}  # the round wall's nearest x in the lane


def test_a_real_drive_replayed_as_an_ld06(hokuyo_mm: np.ndarray) -> None:
    """A Hokuyo in a room: 240 degrees, up to 5.6 m. Zones are where its own ranges say."""
    degrees = np.arange(450) * 0.8
    beam = np.round(((-degrees + 180.0) % 360.0 - 180.0 + 120.0) / 240.0 * 682).astype(int)
    there = (beam >= 0) & (beam < 683)
    turns = [np.where(there, row[np.clip(beam, 0, 682)], 0) for row in hokuyo_mm]
    mm = np.concatenate(turns)[: len(turns) * 450 // 12 * 12]
    data = ld06.encode(np.arange(len(mm)) * 0.8, mm, np.where(mm > 0, 200, 0))
    seen = replay(data)
    assert len(seen) == 755
    assert Counter(zones.state for _, zones, _ in seen)["online"] > 745
    levels = Counter(zones.level for _, zones, _ in seen)
    assert min(levels.values()) > 50
    assert len(levels) == 3
    # Without persistence, each distance is one that this very turn's own ranges show
    off = LidarConfig(persistence=PersistenceSection(raise_scans=1, clear_scans=1))
    near = 0
    for _, zones, scan in replay(data, LidarPipeline(off)):
        ahead, aside = scan.ranges_m * np.cos(scan.angles_rad), scan.ranges_m * np.sin(scan.angles_rad)
        centre = ahead[(np.abs(aside) <= 0.126) & (ahead > 0.18)]
        if zones.centre.points:
            near += 1
            assert np.abs(centre - zones.centre.nearest_m).min() < 0.002
    assert near > 300


@pytest.mark.parametrize(("ahead_m", "levels"), [(0.0, ["SAFE"] * 4), (0.5, ["SAFE", "SAFE", "IMMINENT", "IMMINENT"])])
def test_after_a_silence_neither_the_old_alarm_nor_all_clear_is_told(
    scan_of: Callable[..., LaserScan], ahead_m: float, levels: list[str]
) -> None:
    """A board at 0.5 m, the plug out for 20 s, then board or free lane: degraded until three scans have seen it."""
    pipeline = LidarPipeline(LidarConfig())
    board = scan_of([(0.5, -0.1, 0.1)], 3.0)
    before = [pipeline.process(START_NS + n * 10**8, board) for n in range(5)][-1]
    assert (before.level, before.state) == ("IMMINENT", "online")
    again = scan_of([(ahead_m, -0.1, 0.1)] if ahead_m else [], 3.0)
    after = [pipeline.process(START_NS + 20 * 10**9 + n * 10**8, again) for n in range(4)]
    assert [zones.level for zones in after] == levels
    assert [zones.state for zones in after] == ["degraded", "degraded", "online", "online"]
    assert "looking again" in after[0].reason


def test_a_lens_that_was_covered_during_a_silence_is_never_all_clear(scan_of: Callable[..., LaserScan]) -> None:
    pipeline = LidarPipeline(LidarConfig())
    for n in range(5):
        pipeline.process(START_NS + n * 10**8, scan_of([(0.5, -0.1, 0.1)], 3.0))
    nothing = [pipeline.process(START_NS + 20 * 10**9 + n * 10**8, scan_of([], 0.0)) for n in range(30)]
    assert {zones.state for zones in nothing} == {"degraded"}


def test_picture_shows_lanes_returns_and_words(scan_of: Callable[..., LaserScan]) -> None:
    pipeline, config = LidarPipeline(LidarConfig()), LidarConfig()
    scan = scan_of([(0.5, 0.14, 0.3)], 2.5)
    for number in range(4):
        zones = pipeline.process(START_NS + number * 10**8, scan)
    picture = draw(scan, pipeline.reject_reason, zones, config)
    red = np.argwhere((np.abs(picture[110:].astype(int) - (50, 50, 220)) < 30).all(axis=2))
    middle = picture.shape[1] / 2
    assert (zones.left.level, zones.right.level) == ("IMMINENT", "SAFE")
    assert np.count_nonzero(red[:, 1] < middle) > np.count_nonzero(red[:, 1] > middle)  # left is left here too


@pytest.mark.slow
def test_plot_writes_a_picture(tmp_path: Path, stream_of: Callable[..., bytes]) -> None:
    recording, picture = tmp_path / "room.ld06", tmp_path / "out.png"
    recording.write_bytes(stream_of(lambda angle, _: np.full_like(angle, 1.5), turns=5))
    command = [
        sys.executable,
        "-m",
        "services.jetson.lidar",
        "--plot",
        str(picture),
        "--source",
        f"file:{recording}?rate=0",
    ]
    said = subprocess.run(command, check=True, timeout=60, capture_output=True, text=True).stdout
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert said == f"{picture}: the last of 4 turns\n"


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("none/out.png", b"\x54", "no folder"),
        ("out.xyz", b"\x54", "the name has to end in .png or .jpg"),
        ("out.png", b"no packet of a lidar", "not one whole turn came"),
    ],
)
def test_a_picture_that_cannot_be_drawn_is_refused(tmp_path: Path, name: str, content: bytes, said: str) -> None:
    recording = tmp_path / "room.ld06"
    recording.write_bytes(content)
    with pytest.raises(ConfigError, match=said):
        plot_scans(LidarConfig(source=f"file:{recording}?rate=0"), tmp_path / name, 5)
    assert not (tmp_path / name).exists()
