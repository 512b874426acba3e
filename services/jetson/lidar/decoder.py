"""Bytes with the time of their arrival -> scans; what was rejected on the way goes into the service's report."""

from __future__ import annotations

from common.bus.status import Report
from common.messages import LaserScan
from services.jetson.lidar.assembly import FAMILY, ScanAssembler
from services.jetson.lidar.config import LidarConfig
from services.jetson.lidar.parser import PACKET_BYTES, POINTS, Ld06Parser
from services.jetson.lidar.timing import MAX_DRIFT

# Worth knowing, but nothing was wrong with a packet: the rest of the counters is bad input.
NO_FAULT = ("packets", "skipped_bytes", "partial_scans", "clock_restarts")


class ScanDecoder:
    """Bytes with arrival times -> scans, and the counts of what was rejected on the way into the report."""

    def __init__(self, config: LidarConfig, report: Report, max_drift: float = MAX_DRIFT) -> None:
        self._config, self._report, self._max_drift = config, report, max_drift
        self.restarts = -1
        self.restart()

    def restart(self) -> None:
        """Forget the stream so far: the device is a new one."""
        self.restarts += 1
        self.parser = Ld06Parser(self._config.scan.sample_rate_hz, self._config.mounting.clockwise)
        self.assembler = ScanAssembler(self._config, self._max_drift)
        self._reported: dict[str, int] = {}
        self._last_packet_s: float | None = None
        self._last_byte_s: float | None = None

    def feed(self, arrival_ns: int, now_s: float, data: bytes) -> list[LaserScan]:
        """The scans that these bytes complete."""
        packets = self.parser.feed(data)
        scans = self.assembler.add(packets, arrival_ns)
        for scan in scans:
            scan.received_ns = arrival_ns
        if scans:
            self._report_counts()
        self._watch(now_s, bool(packets), bool(data))
        return scans

    def wanted_s(self) -> float:
        """How long until the bytes that close the revolution have come: a reader may sleep nearly as long."""
        packets = self.assembler.packets_to_index() - self.parser.pending / PACKET_BYTES
        return packets * POINTS / self._config.scan.sample_rate_hz

    def missing_bytes(self) -> int:
        """How many bytes complete the next packet: what a reader may wait for at once."""
        return PACKET_BYTES - self.parser.pending

    def _report_counts(self) -> None:
        counts = {**self.parser.counters, **self.assembler.counters}
        for name, count in counts.items():
            new = count - self._reported.get(name, 0)
            (self._report.count if name in NO_FAULT else self._report.bad_input)(name, new)
        self._reported = counts

    def _watch(self, now_s: float, packets: bool, data: bool) -> None:
        """Call the device lost when no believable packet has come for a while, and say whether anything has."""
        if packets or self._last_packet_s is None:
            self._last_packet_s = now_s
        if data or self._last_byte_s is None:
            self._last_byte_s = now_s
        patience_s = self._config.serial.silence_s
        if now_s - self._last_packet_s < patience_s:
            return
        if now_s - self._last_byte_s < patience_s:
            self._report_counts()
            why = self._without_packets()
        else:
            why = "connected but silent: is the motor turning, and are 5 V and the data line connected?"
        self._report.state("disconnected", why)

    def _without_packets(self) -> str:
        """Why bytes arrive but no packet is believed."""
        counters = self.parser.counters
        if counters["angle_span"] > counters["crc"] and counters["angle_span"] > counters["packets"]:
            rate_hz = self._config.scan.sample_rate_hz
            return f"the packets' angles do not fit [scan] sample_rate_hz = {rate_hz:.0f}: {FAMILY}"
        return "bytes arrive but no LD06 packet is among them: wrong device, baud rate or a bad line"
