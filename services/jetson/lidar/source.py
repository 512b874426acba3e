"""Where revolutions come from: a serial port, a file of raw bytes, a recording of the bus, or the simulated world.

All are streams of bytes with the time of their arrival; behind that, everything is the same. The scans of a ROS 2
driver (``ros2:``) come as they are.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import serial

from common.backoff import Backoff
from common.bus.raw_tap import RawTap, null_tap
from common.bus.status import Report
from common.clock import monotonic_s, utc_at, utc_ns
from common.config import ConfigError
from common.messages import LaserScan, Motion
from common.pacing import wait_until
from common.recording.raw import MCAP_PARAMETERS, recorded_motion, replayed
from common.ros2.source import ROS2_PARAMETERS, require_rosbags
from common.serial_port import PORT_ERRORS, explain
from common.source_url import SourceUrl, parse_source
from common.topics import LIDAR_RAW
from services.jetson.lidar.config import LidarConfig, SerialSection
from services.jetson.lidar.decoder import ScanDecoder
from services.jetson.lidar.parser import PACKET_BYTES, POINTS
from services.jetson.lidar.timing import MAX_DRIFT

log = logging.getLogger(__name__)

Chunks = Iterator[tuple[int, bytes]]  # (UTC ns of arrival, bytes); b"" means that nothing came

SCHEMES = {
    "serial": (),
    "file": ("rate", "loop"),
    "sim": ("t0",),
    "mcap": MCAP_PARAMETERS,
    "ros2": (*ROS2_PARAMETERS, "confidence"),
}
FILE_CHUNK_BYTES = 8 * PACKET_BYTES
READ_TIMEOUT_S = 0.05
LONGEST_PAUSE_S = 0.1  # the system keeps 4 kB for us: more than 0.2 s of the sensor
AWAKE_S = 0.006  # before the closing byte is due: a packet may be early, and our wake-up late
SIM_TICK_S = 0.01
REPLAY_DRIFT = 10.0  # a replay may run slower than the recording: stamps follow the arrival


def open_source(
    config: LidarConfig, report: Report, raw: RawTap | Callable[..., None] = null_tap
) -> Iterator[tuple[int, LaserScan]]:
    """Give ``(stamp_ns, scan)`` as each revolution closes; ``raw`` gets the bytes. Nothing is opened before the first.

    Raises:
        ConfigError: at once for an unknown scheme, parameter or scenario or no such file; later for a file that cannot
            be read.
    """
    url = parse_source(config.source, {name: tuple(params) for name, params in SCHEMES.items()})
    if url.scheme in ("file", "mcap") and not Path(url.target).expanduser().exists():
        raise ConfigError(f"source {url}: no such file")
    if url.scheme == "sim":
        from spotter_sim.scenario_clock import ScenarioClock

        ScenarioClock(url)  # refuses a scenario that there is not
    return _ros(url, config, report) if url.scheme == "ros2" else _scans(url, config, report, raw)


def _scans(
    url: SourceUrl, config: LidarConfig, report: Report, raw: RawTap | Callable[..., None]
) -> Iterator[tuple[int, LaserScan]]:
    true_pace = url.scheme in ("serial", "sim") or (url.scheme == "mcap" and url.number("rate", 1.0) in (0.0, 1.0))
    decoder = ScanDecoder(config, report, MAX_DRIFT if true_pace else REPLAY_DRIFT)
    recorded: list[Motion | None] = [None]  # of the piece of a recording that is read now
    for arrival_ns, data in _chunks(url, config, decoder, report, recorded):
        for scan in decoder.feed(arrival_ns, monotonic_s(), data):
            scan.motion = recorded[0]
            yield scan.stamp_ns, scan
        if data:
            raw("ld06", arrival_ns, data, epoch=decoder.restarts)


def _ros(url: SourceUrl, config: LidarConfig, report: Report) -> Iterator[tuple[int, LaserScan]]:
    require_rosbags(url)
    from services.jetson.lidar.ros2 import ros_scans

    return ros_scans(url, config, report)


def _chunks(
    url: SourceUrl, config: LidarConfig, decoder: ScanDecoder, report: Report, recorded: list[Motion | None]
) -> Chunks:
    if url.scheme == "serial":
        return SerialBytes(url.target, config.serial, report, decoder).chunks()
    if url.scheme == "file":
        return file_chunks(url, config.scan.sample_rate_hz, decoder.restart)
    if url.scheme == "mcap":
        return recorded_chunks(url, decoder.restart, recorded)
    return sim_chunks(url)


def file_chunks(url: SourceUrl, sample_rate_hz: float, restart: Callable[[], None]) -> Chunks:
    """Raw bytes at the pace at which the sensor sends them; ``rate=0`` reads as fast as possible.

    Raises:
        ConfigError: the file is missing, unreadable or empty.
    """
    try:
        recording = Path(url.target).expanduser().read_bytes()
    except OSError as error:
        raise ConfigError(f"source {url}: {error.strerror}: a file of raw LD06 bytes is expected") from None
    if not recording:
        raise ConfigError(f"source {url}: the file is empty")
    rate = url.number("rate", 1.0)
    byte_s = POINTS / sample_rate_hz / PACKET_BYTES
    begin_s, sent = monotonic_s(), 0
    while True:
        for at in range(0, len(recording), FILE_CHUNK_BYTES):
            chunk = recording[at : at + FILE_CHUNK_BYTES]
            sent += len(chunk)
            due_s = begin_s + sent * byte_s / (rate or 1.0)
            if rate:
                wait_until(due_s)
            yield utc_at(due_s), chunk
        if not url.flag("loop"):
            return
        restart()


def recorded_chunks(url: SourceUrl, restart: Callable[[], None], recorded: list[Motion | None] | None = None) -> Chunks:
    """The bytes of a recording as they arrived; the port was opened anew where the epoch changes.

    ``recorded`` holds afterwards how the vehicle was known to move then.

    Raises:
        ConfigError: no recording, or one without raw bytes of a lidar.
    """
    epoch: int | None = None
    for piece in replayed(url, LIDAR_RAW):
        if epoch is not None and (piece.epoch != epoch or piece.index == 0):
            restart()
        epoch = piece.epoch
        if recorded is not None:
            recorded[0] = recorded_motion(piece)
        yield piece.stamp_ns, piece.data.tobytes()


def sim_chunks(url: SourceUrl) -> Chunks:
    """The byte stream of the simulated LD06 as the world's clock goes on."""
    from spotter_sim import ld06
    from spotter_sim.scenario_clock import ScenarioClock

    clock, last_s = ScenarioClock(url), monotonic_s()
    while True:
        time.sleep(SIM_TICK_S)
        now_s = monotonic_s()
        yield utc_at(now_s), ld06.packets(clock.scenario, clock.at(last_s), clock.at(now_s))
        last_s = now_s


class SerialBytes:
    """Reads a port for ever. While it is away, ``report`` says why, and it is tried again with a growing pause.

    Args:
        port: path of the device.
        config: baud rate and patience.
        report: receives "disconnected" with the reason.
        decoder: is restarted whenever the port has been opened anew, and knows when the next scan will be complete.
    """

    def __init__(self, port: str, config: SerialSection, report: Report, decoder: ScanDecoder) -> None:
        self._port, self._config, self._report, self._decoder = port, config, report, decoder
        self._was_open = False
        self._logged = ""

    def chunks(self) -> Iterator[tuple[int, bytes]]:
        """``(UTC ns of arrival, bytes)``; b"" when nothing came in time."""
        backoff = Backoff(self._config.retry_first_s, self._config.retry_max_s)
        while True:
            try:
                with self._open() as device:
                    self._was_open, self._logged = True, ""
                    self._decoder.restart()
                    for data in self._read(device):
                        if data:
                            backoff.reset()
                        yield utc_ns(), data
            except PORT_ERRORS as error:
                self._report_disconnected(explain(self._port, error, self._was_open))
                self._report.count("port_failures")
            time.sleep(backoff.next_s())

    def _report_disconnected(self, reason: str) -> None:
        """In the status always, in the log once for each reason: it is tried again every few seconds."""
        self._report.state("disconnected", reason)
        if reason != self._logged:
            log.warning("%s", reason)
            self._logged = reason

    def _open(self) -> serial.Serial:
        return serial.Serial(self._port, self._config.baud_rate, timeout=READ_TIMEOUT_S, exclusive=True)

    def _read(self, device: serial.Serial) -> Iterator[bytes]:
        """Sleep while most of a revolution arrives, be awake for its last bytes: waking for each packet costs more
        than everything that is done with it."""
        while True:
            time.sleep(min(max(0.0, self._decoder.wanted_s() - AWAKE_S), LONGEST_PAUSE_S))
            yield device.read(max(device.in_waiting, self._decoder.missing_bytes()))
