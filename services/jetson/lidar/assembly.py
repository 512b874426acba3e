"""Packets -> revolutions, in the vehicle's frame of mounting (x forward, counter-clockwise).

A revolution is cut where the sweep has just left the forward cone, not at the sensor's own zero, which points forward:
there, half of the cone would be a whole turn old whenever a scan is published.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable

import numpy as np

from common.geometry import wrap_angle
from common.messages import LaserScan
from services.jetson.lidar.config import LidarConfig
from services.jetson.lidar.parser import POINTS, Packet
from services.jetson.lidar.timing import MAX_DRIFT, DeviceClock

Piece = tuple[Packet, int, int]  # a packet, and the first and behind-last of its returns that belong
HALF_TURN_DEG = 180.0
CLOCK_RESOLUTION_MS = 1.0
WRONG_RATE = 1.4  # times the configured rate; a packet of a slower sensor is refused by the parser
MIN_PACKETS_FOR_RATE = 10
FAMILY = "LD06 and LD19 give 4500, the STL-27L 21600 (services/jetson/lidar/stl27l.toml)"
TOO_LONG = 1.4  # vendor SDK: a revolution with more returns than this times the expected ones has lost its index


class ScanAssembler:
    """Collects packets and gives out a ``LaserScan`` as soon as one crosses the index.

    ``counters`` holds what was lost or dropped: ``lost_packets`` (from gaps in the sensor's clock), ``gaps``,
    ``clock_restarts``, ``partial_scans`` (the first, incomplete one), ``overlong_scans``.

    Args:
        config: mounting, cone and scan sections are used.
        max_drift: see ``DeviceClock``.
    """

    def __init__(self, config: LidarConfig, max_drift: float = MAX_DRIFT) -> None:
        mounting, scan = config.mounting, config.scan
        self.counters: Counter[str] = Counter()
        self._scan = scan
        self._yaw_rad = math.radians(mounting.yaw_deg)
        self._mirror = -1.0 if mounting.upside_down else 1.0
        self._index_deg = index_deg(config)
        self._clock = DeviceClock(max_drift)
        self._packet_ms = POINTS / scan.sample_rate_hz * 1e3
        self._synced = False  # an index has been crossed since the start: what follows is a whole revolution
        self._last_ms: int | None = None
        self._last_turn_deg = 0.0
        self._span_deg = 0.0
        self._gap_deg = 0.0
        self._began_ms = 0
        self._pieces: list[Piece] = []

    def add(self, packets: Iterable[Packet], arrival_ns: int) -> list[LaserScan]:
        """The revolutions that these packets, which arrived at ``arrival_ns`` (UTC), complete."""
        scans: list[LaserScan] = []
        for packet in packets:
            device_ms, utc = self._clock.advance(packet.timestamp_ms, arrival_ns)
            scans += self._add(packet, device_ms, utc)
        self.counters["clock_restarts"] = self._clock.restarts
        return scans

    def packets_to_index(self) -> int:
        """How many packets until the revolution closes, at least one: what a reader may wait for at once."""
        per_packet_deg = max(self._span_deg * POINTS / (POINTS - 1), 1e-3)
        return max(1, math.ceil((360.0 - self._last_turn_deg) / per_packet_deg - 1e-6))

    def _add(self, packet: Packet, device_ms: int, utc: int) -> list[LaserScan]:
        self._notice_gap(packet, device_ms)
        self._span_deg = (packet.end_deg - packet.start_deg) % 360.0
        start_deg = (packet.start_deg - self._index_deg) % 360.0
        scans: list[LaserScan] = []
        if self._skipped_index(start_deg):
            scans = self._close(utc, POINTS / self._scan.sample_rate_hz)
            self._synced = self._gap_deg <= HALF_TURN_DEG
            self._began_ms = device_ms
        turn_deg = start_deg + self._span_deg
        before = POINTS
        if turn_deg >= 360.0:  # the index is inside this packet
            before = math.ceil((360.0 - start_deg) * (POINTS - 1) / self._span_deg - 1e-9)
        self._pieces.append((packet, 0, before))
        if before < POINTS:
            scans += self._close(utc, (POINTS - before) / self._scan.sample_rate_hz)
            self._pieces.append((packet, before, POINTS))
            self._began_ms = device_ms
        elif device_ms - self._began_ms > self._scan.longest_s * 1e3:
            scans += self._close(utc, 0.0, stalled=True)
            self._began_ms = device_ms
        self._last_turn_deg = turn_deg % 360.0
        self._last_ms = device_ms
        return scans

    def _notice_gap(self, packet: Packet, device_ms: int) -> None:
        """A step of the sensor's clock beyond a packet's period and its resolution of 1 ms is loss."""
        step_ms = 0 if self._last_ms is None else device_ms - self._last_ms
        self._gap_deg = 0.0
        if self._last_ms is None:
            self._began_ms = device_ms
        if step_ms > self._packet_ms + CLOCK_RESOLUTION_MS:
            self.counters["gaps"] += 1
            self.counters["lost_packets"] += max(1, round(step_ms / self._packet_ms) - 1)
            self._gap_deg = step_ms * 1e-3 * packet.speed_dps

    def _skipped_index(self, start_deg: float) -> bool:
        """The index lies between the last packet and this one, or so much is missing that it may."""
        fell = start_deg < self._last_turn_deg - HALF_TURN_DEG
        return bool(self._pieces) and (fell or self._gap_deg > HALF_TURN_DEG)

    def _close(self, utc: int, after_s: float, stalled: bool = False) -> list[LaserScan]:
        """The revolution collected so far as a scan; ``after_s`` is how long ago its last return was."""
        pieces, self._pieces = self._pieces, []
        whole = self._synced
        self._synced = True
        if not pieces or not (whole or stalled):
            self.counters["partial_scans"] += bool(pieces)
            return []
        speed_hz = float(np.median([packet.speed_dps for packet, _, _ in pieces])) / 360.0
        points = sum(stop - start for _, start, stop in pieces)
        wrong_rate = self._wrong_rate([packet for packet, _, _ in pieces])
        if not stalled and not wrong_rate and points * speed_hz > TOO_LONG * self._scan.sample_rate_hz:
            self.counters["overlong_scans"] += 1
            return []
        scan = self._scan_of(pieces, utc - int(after_s * 1e9))
        if wrong_rate:
            scan.state, scan.reason = "degraded", wrong_rate
        elif stalled or speed_hz < self._scan.slowest_hz:
            scan.state = "degraded"
            scan.reason = f"motor slow or stalled: {speed_hz:.1f} turns a second; is the scanner free to turn?"
        return [scan]

    def _wrong_rate(self, packets: list[Packet]) -> str:
        """A sentence when the packets' own angles and speed tell another sample rate than the configuration; or ""."""
        spans_deg = np.array([(packet.end_deg - packet.start_deg) % 360.0 for packet in packets])
        speeds_dps = np.array([packet.speed_dps for packet in packets])
        turning = (spans_deg > 0.0) & (speeds_dps >= 360.0 * self._scan.slowest_hz)
        if np.count_nonzero(turning) < MIN_PACKETS_FOR_RATE:
            return ""
        rate_hz = float(np.median(speeds_dps[turning] * (POINTS - 1) / spans_deg[turning]))
        if rate_hz <= WRONG_RATE * self._scan.sample_rate_hz:
            return ""
        return (
            f"the packets tell {round(rate_hz, -2):.0f} returns a second, [scan] sample_rate_hz says "
            f"{self._scan.sample_rate_hz:.0f}: {FAMILY}"
        )

    def _scan_of(self, pieces: list[Piece], stamp_ns: int) -> LaserScan:
        angles = np.concatenate([packet.angles_rad[i:j] for packet, i, j in pieces])
        distances = np.concatenate([packet.distances_mm[i:j] for packet, i, j in pieces])
        confidence = np.concatenate([packet.confidence[i:j] for packet, i, j in pieces])
        return LaserScan(
            stamp_ns=stamp_ns,
            frame_id="lidar",
            angles_rad=wrap_angle(self._mirror * angles + self._yaw_rad).astype(np.float32),
            ranges_m=(distances * 1e-3).astype(np.float32),
            confidence=confidence,
        )


def index_deg(config: LidarConfig) -> float:
    """Where a revolution is cut, in the sensor's own degrees: just behind the forward cone, in the way it sweeps."""
    mounting = config.mounting
    sweep = (-1.0 if mounting.clockwise else 1.0) * (-1.0 if mounting.upside_down else 1.0)
    behind_cone_deg = config.zones.fov_deg / 2 + config.scan.cut_after_cone_deg
    return (behind_cone_deg - sweep * mounting.yaw_deg) % 360.0
