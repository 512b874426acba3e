"""LD06 lidar: how fast, how late, how fooled. Run with ``python -m benchmarks.onboard.ld06``; about 100 seconds.

The service part is real: the service's own process, a pseudo-terminal fed byte for byte at the sensor's pace, a Zenoh
router on loopback. Speeds are given as multiples of the line rate (375 packets a second) and of a plain parser that
ran in the same process.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import zenoh

from common.bus.session import build, open_session
from common.bus.status import Report
from common.codec import decode, encode
from common.config import ZenohConfig
from common.messages import LaserScan, LidarZones, ServiceStatus
from common.topics import LIDAR_ZONES, status_topic
from services.jetson.lidar.config import LidarConfig, PersistenceSection, ZonesSection
from services.jetson.lidar.decoder import ScanDecoder
from services.jetson.lidar.parser import PACKET_BYTES, Ld06Parser
from services.jetson.lidar.pipeline import LidarPipeline
from spotter_sim import ld06

LINE_RATE_HZ = 375.0
START_NS = 1_800_000_000_000_000_000
RANDOM_MB = 100
SERVICE_S = 60.0
# Random fields that look like a packet: both angles, speed, time stamp in range, and the span small for the speed
PLAUSIBLE_SHARE = 0.549**2 * 0.110 * 0.458 * 0.042


def main() -> None:
    """Print all five tables: random bytes, throughput, flicker, rods, and the running service."""
    random_bytes()
    throughput()
    flicker()
    rods()
    service()


def random_bytes() -> None:
    """How many false packets random bytes make, against what two header bytes and eight bits of CRC let through."""
    rng, parser, found = np.random.default_rng(1), Ld06Parser(4500.0), 0
    begin_s = time.perf_counter()
    for _ in range(RANDOM_MB):
        found += len(parser.feed(rng.bytes(1_000_000)))
    seconds = time.perf_counter() - begin_s
    passed_crc = found + sum(parser.counters[name] for name in parser.counters if "_range" in name or "_span" in name)
    print(f"random bytes: {RANDOM_MB} MB in {seconds:.1f} s, at most {parser.pending} bytes kept")
    print(f"  header and CRC by chance   expected {RANDOM_MB * 1e6 / 2**24:5.1f}   measured {passed_crc}")
    print(f"  accepted as packets        expected {RANDOM_MB * 1e6 / 2**24 * PLAUSIBLE_SHARE:5.3f}   measured {found}")


def throughput() -> None:
    """Parse, assemble, zones on the simulated `crossing`, in the pieces that a serial port delivers."""
    data = ld06.packets("crossing", 0.0, 15.0)
    packets = len(data) / PACKET_BYTES
    print(f"throughput, {packets:.0f} packets of `crossing`      packets/s   x line rate   x plain parser")
    plain_s = _seconds(lambda: plain_parse(data[: len(data) // 5])) * 5
    for name, run in (
        ("plain parser, byte by byte", None),
        ("parse, all at once", lambda: Ld06Parser(4500.0).feed(data)),
        ("parse, one packet a call", lambda: _feed(Ld06Parser(4500.0), data)),
        ("parse + assemble + zones, 8 packets a call", lambda: _whole(data)),
    ):
        seconds = plain_s if run is None else _seconds(run)
        rate = packets / seconds
        print(f"  {name:43s} {rate:9.0f} {rate / LINE_RATE_HZ:10.0f} {plain_s / seconds:12.1f}")
    scans, took_ms = [], []
    decoder, pipeline = ScanDecoder(LidarConfig(), Report("bench")), LidarPipeline(LidarConfig())
    for number, at in enumerate(range(0, len(data), PACKET_BYTES)):
        begin_s = time.perf_counter()
        scans = decoder.feed(START_NS + int(number / LINE_RATE_HZ * 1e9), 0.0, data[at : at + PACKET_BYTES])
        for scan in scans:
            encode(pipeline.process(scan.stamp_ns, scan))
            took_ms.append((time.perf_counter() - begin_s) * 1e3)
    p50, p99 = np.percentile(took_ms, [50, 99])
    print(f"  last packet in, encoded zones out: p50 {p50:.2f} ms, p99 {p99:.2f} ms")


def plain_parse(data: bytes) -> int:
    """The obvious parser: a table for the CRC, a loop over the bytes, lists for the points."""
    found, at = 0, 0
    while at + PACKET_BYTES <= len(data):
        packet = data[at : at + PACKET_BYTES]
        if packet[0] == 0x54 and packet[1] == 0x2C and ld06.crc8(packet[:46]) == packet[46]:
            start, end = (int.from_bytes(packet[i : i + 2], "little") / 100 for i in (4, 42))
            step = (end - start) % 360 / 11
            points = [
                ((start + step * i) % 360, int.from_bytes(packet[6 + 3 * i : 8 + 3 * i], "little"), packet[8 + 3 * i])
                for i in range(12)
            ]
            found += bool(points)
            at += PACKET_BYTES
        else:
            at += 1
    return found


def flicker(scans: int = 10_000) -> None:
    """Alerts against truth under noise, dropouts and bursts of ghosts, with persistence and without."""
    off = LidarConfig(persistence=PersistenceSection(raise_scans=1, clear_scans=1))
    pipelines = {"persistence on": LidarPipeline(LidarConfig()), "persistence off": LidarPipeline(off)}
    alarms: dict[str, list[bool]] = {name: [] for name in pipelines}
    truth = []
    for there, scan in noisy_board(scans):
        truth.append(there)
        for name, pipeline in pipelines.items():
            alarms[name].append(pipeline.process(scan.stamp_ns, scan).level == "IMMINENT")
    print(f"flicker, {scans} scans, 4 % of them wrong as a whole      raised   cleared   wrong scans")
    for name, got in (("truth", truth), *alarms.items()):
        raised = sum(b and not a for a, b in pairwise(got))
        cleared = sum(a and not b for a, b in pairwise(got))
        wrong = sum(a != b for a, b in zip(got, truth, strict=True))
        print(f"  {name:52s} {raised:6d} {cleared:9d} {wrong:11d}")


def noisy_board(scans: int) -> Iterator[tuple[bool, LaserScan]]:
    """A wall at 3 m; in 20 scans of every 100 a board at 0.6 m. Noise 12 mm, 2 % of the beams lost, 4 % of the scans
    either without the board or with a burst of ghosts that agree."""
    rng = np.random.default_rng(11)
    angles = (-np.pi + (np.arange(450) + 0.5) * 2 * np.pi / 450).astype(np.float32)
    y = 0.6 * np.tan(np.clip(angles, -1.5, 1.5))
    board_m = np.where((np.abs(angles) < 1.0) & (np.abs(y) < 0.1), 0.6 / np.cos(angles), 3.0)
    ahead = np.abs(angles) < np.radians(8.0)
    for number in range(scans):
        there = number % 100 >= 80
        ranges = (board_m if there else np.full(450, 3.0)) + rng.normal(0.0, 0.012, 450)
        if rng.random() < 0.04:
            ranges[ahead] = 3.0 if there else 0.5
        ranges[rng.random(450) < 0.02] = 0.0
        yield (
            there,
            LaserScan(
                stamp_ns=START_NS + number * 100_000_000,
                angles_rad=angles,
                ranges_m=ranges.astype(np.float32),
                confidence=np.full(450, 200, np.uint8),
            ),
        )


def rods(scans: int = 300) -> None:
    """Share of scans in which a thin rod alarms: vouched for by one turn alone, and over three turns."""
    distances_m = (0.3, 0.5, 0.8, 1.2)
    print("rods, % of scans that alarm, one turn / three   " + "".join(f"{d:10.1f} m" for d in distances_m))
    for width_m in (0.010, 0.015, 0.020, 0.025, 0.030):
        cells = []
        for distance_m in distances_m:
            shares = []
            for zones in (ZonesSection(thin_scans=1), ZonesSection()):
                pipeline = LidarPipeline(LidarConfig(zones=zones))
                seen = (pipeline.process(scan.stamp_ns, scan) for scan in rod_scans(width_m, distance_m, scans))
                shares.append(100 * float(np.mean([one.level != "SAFE" for one in list(seen)[10:]])))
            cells.append(f"{shares[0]:5.0f} /{shares[1]:4.0f}")
        print(f"  {100 * width_m:.1f} cm" + " " * 38 + "  ".join(cells))


def rod_scans(width_m: float, distance_m: float, scans: int) -> Iterator[LaserScan]:
    """A rod before a wall at 3 m; every turn begins at another angle, 6 mm of noise on the rod, 2 % of beams lost."""
    rng = np.random.default_rng(3)
    for number in range(scans):
        angles = -np.pi + (np.arange(450) + rng.random()) * 2 * np.pi / 450
        ranges = 3.0 + rng.normal(0.0, 0.012, 450)
        hit = (np.abs(angles) < 1.0) & (np.abs(distance_m * np.tan(np.clip(angles, -1.5, 1.5))) < width_m / 2)
        ranges[hit] = distance_m + rng.normal(0.0, 0.006, np.count_nonzero(hit))
        ranges[rng.random(450) < 0.02] = 0.0
        yield LaserScan(
            stamp_ns=START_NS + number * 100_000_000,
            angles_rad=angles.astype(np.float32),
            ranges_m=ranges.astype(np.float32),
            confidence=np.full(450, 200, np.uint8),
        )


def service() -> None:
    """The service's own process on a pseudo-terminal: share of a core, and last byte written to zones received."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    master, slave = os.openpty()
    arrivals: list[tuple[float, LidarZones]] = []
    status: list[ServiceStatus] = []
    command = [sys.executable, "-m", "services.jetson.lidar", "--source", f"serial:{os.ttyname(slave)}"]
    command += ["--set", f'zenoh.connect=["{endpoint}"]']
    with (
        zenoh.open(build(ZenohConfig(mode="router", connect=(), listen=(endpoint,), namespace=""))),
        open_session(ZenohConfig(connect=(endpoint,))) as session,
    ):
        zones_key, status_key = LIDAR_ZONES.key("jetson0"), status_topic("lidar").key("jetson0")
        kept = [
            session.declare_subscriber(
                zones_key, lambda s: arrivals.append((time.monotonic(), decode(s.payload.to_bytes(), LidarZones)))
            ),
            session.declare_subscriber(
                status_key, lambda s: status.append(decode(s.payload.to_bytes(), ServiceStatus))
            ),
        ]
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        try:
            closings = _feed_at_pace(master, SERVICE_S)
        finally:
            process.terminate()
            process.wait(10)
        del kept
    _print_service(closings, arrivals, status)


def _feed_at_pace(master: int, seconds: float) -> list[float]:
    """Write each packet when its last byte would have come; the times at which a packet closed a turn."""
    data = ld06.packets("crossing", 0.0, 15.0)
    packets = [data[at : at + PACKET_BYTES] for at in range(0, len(data), PACKET_BYTES)]
    closing, pace, began_s = [], threading.Event(), time.monotonic()
    last_deg = 0.0
    for number in range(int(seconds * LINE_RATE_HZ)):
        packet = packets[number % len(packets)]
        pace.wait(max(0.0, began_s + number / LINE_RATE_HZ - time.monotonic()))
        written_s = time.monotonic()
        os.write(master, packet)
        end_deg = (int.from_bytes(packet[42:44], "little") / 100 - 25.0) % 360.0  # the service's index is at 25 degrees
        if end_deg < last_deg:
            closing.append(written_s)
        last_deg = end_deg
    return closing


def _print_service(
    closings: list[float], arrivals: list[tuple[float, LidarZones]], status: list[ServiceStatus]
) -> None:
    """Each zone message belongs to the newest closing before it; in its first second the service works off what piled
    up before it had opened the port."""
    latency_ms = [1e3 * min(at - c for c in closings if c <= at) for at, _ in arrivals[10:]]
    running = [one for one in status if one.state == "online"]
    first, last = running[0], running[-1]
    share = (last.cpu_s - first.cpu_s) / ((last.stamp_ns - first.stamp_ns) * 1e-9)
    p50, p99 = np.percentile(latency_ms, [50, 99])
    print(f"service, its own process, {SERVICE_S:.0f} s at 10 Hz over a pseudo-terminal and real Zenoh")
    print(f"  {len(arrivals)} zone messages, {last.bad_input} bad inputs, {last.rss_mb:.0f} MB resident")
    print(f"  share of a core {100 * share:.1f} %")
    print(f"  last byte written to zones received: p50 {p50:.2f} ms, p99 {p99:.2f} ms")


def _feed(parser: Ld06Parser, data: bytes) -> None:
    for at in range(0, len(data), PACKET_BYTES):
        parser.feed(data[at : at + PACKET_BYTES])


def _whole(data: bytes) -> None:
    decoder, pipeline = ScanDecoder(LidarConfig(), Report("bench")), LidarPipeline(LidarConfig())
    for number, at in enumerate(range(0, len(data), 8 * PACKET_BYTES)):
        for scan in decoder.feed(
            START_NS + int(number * 8 / LINE_RATE_HZ * 1e9), 0.0, data[at : at + 8 * PACKET_BYTES]
        ):
            pipeline.process(scan.stamp_ns, scan)


def _seconds(run) -> float:  # type: ignore[no-untyped-def]
    """Seconds of processor time, which a busy machine does not stretch as it stretches the clock's."""
    begin_s = time.process_time()
    run()
    return time.process_time() - begin_s


if __name__ == "__main__":
    main()
