"""Where revolutions come from: a serial port, a file of raw bytes, a recording of the bus, or the simulated world.

All are streams of bytes with the time of their arrival; behind that, everything is the same.
"""

from __future__ import annotations

import errno
import os
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import serial

from common.clock import monotonic_s, utc_at, utc_ns
from common.config import ConfigError
from common.messages import LaserScan
from common.raw import RawTap, unheard
from common.recording.raw import MCAP_PARAMETERS, replayed
from common.source_url import SourceUrl, parse_source
from common.status import Report
from common.topics import LIDAR_RAW
from services.jetson.lidar.config import LidarConfig, SerialSection
from services.jetson.lidar.decoder import ScanDecoder
from services.jetson.lidar.parser import PACKET_BYTES, POINTS
from services.jetson.lidar.timing import MAX_DRIFT

Chunks = Iterator[tuple[int, bytes]]  # (UTC ns of arrival, bytes); b"" means that nothing came

SCHEMES = {"serial": (), "file": ("rate", "loop"), "sim": ("t0",), "mcap": MCAP_PARAMETERS}
FILE_CHUNK_BYTES = 8 * PACKET_BYTES
READ_TIMEOUT_S = 0.05
LONGEST_PAUSE_S = 0.1  # the system keeps 4 kB for us: more than 0.2 s of the sensor
AWAKE_S = 0.006  # before the closing byte is due: a packet may be early, and our wake-up late
SIM_TICK_S = 0.01
REPLAY_DRIFT = 10.0  # a replay may run slower than the recording: stamps follow the arrival


def open_source(
    config: LidarConfig, report: Report, raw: RawTap | Callable[..., None] = unheard
) -> Iterator[tuple[int, LaserScan]]:
    """Yield ``(stamp_ns, scan)`` as each revolution closes; ``raw`` gets the bytes.

    Raises:
        ConfigError: an unknown scheme or parameter, or a file that cannot be read.
    """
    url = parse_source(config.source, {name: tuple(params) for name, params in SCHEMES.items()})
    true_pace = url.scheme in ("serial", "sim") or (url.scheme == "mcap" and url.number("rate", 1.0) in (0.0, 1.0))
    decoder = ScanDecoder(config, report, MAX_DRIFT if true_pace else REPLAY_DRIFT)
    for arrival_ns, data in _chunks(url, config, decoder, report):
        for scan in decoder.feed(arrival_ns, monotonic_s(), data):
            yield scan.stamp_ns, scan
        if data:
            raw("ld06", arrival_ns, data, epoch=decoder.restarts)


def _chunks(url: SourceUrl, config: LidarConfig, decoder: ScanDecoder, report: Report) -> Chunks:
    if url.scheme == "serial":
        return SerialBytes(url.target, config.serial, report, decoder).chunks()
    if url.scheme == "file":
        return file_chunks(url, config.scan.sample_rate_hz, decoder.restart)
    if url.scheme == "mcap":
        return recorded_chunks(url, decoder.restart)
    return sim_chunks(url)


def file_chunks(url: SourceUrl, sample_rate_hz: float, restart: Callable[[], None]) -> Chunks:
    """Raw bytes at the pace at which the sensor sends them; ``rate=0`` reads as fast as possible.

    Raises:
        ConfigError: the file is missing, unreadable or empty.
    """
    try:
        recording = Path(url.target).read_bytes()
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
                time.sleep(max(0.0, due_s - monotonic_s()))
            yield utc_at(due_s), chunk
        if not url.flag("loop"):
            return
        restart()


def recorded_chunks(url: SourceUrl, restart: Callable[[], None]) -> Chunks:
    """The bytes of a recording as they arrived; the port was opened anew where the epoch changes.

    Raises:
        ConfigError: no recording, or one without raw bytes of a lidar.
    """
    epoch: int | None = None
    for piece in replayed(url, LIDAR_RAW):
        if epoch is not None and (piece.epoch != epoch or piece.index == 0):
            restart()
        epoch = piece.epoch
        yield piece.stamp_ns, piece.data.tobytes()


def sim_chunks(url: SourceUrl) -> Chunks:
    """The byte stream of the simulated LD06 as the world's clock goes on."""
    from common.sim import ld06
    from common.sim.scenario_clock import ScenarioClock

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

    def chunks(self) -> Iterator[tuple[int, bytes]]:
        """``(UTC ns of arrival, bytes)``; b"" when nothing came in time."""
        pause_s = self._config.retry_first_s
        while True:
            try:
                with self._open() as device:
                    self._was_open = True
                    self._decoder.restart()
                    for data in self._read(device):
                        if data:
                            pause_s = self._config.retry_first_s
                        yield utc_ns(), data
            except (serial.SerialException, OSError) as error:
                self._report.state("disconnected", explain(self._port, error, self._was_open))
                self._report.count("port_failures")
            time.sleep(pause_s)
            pause_s = min(2.0 * pause_s, self._config.retry_max_s)

    def _open(self) -> serial.Serial:
        return serial.Serial(self._port, self._config.baud_rate, timeout=READ_TIMEOUT_S, exclusive=True)

    def _read(self, device: serial.Serial) -> Iterator[bytes]:
        """Sleep while most of a revolution arrives, be awake for its last bytes: waking for each packet costs more
        than everything that is done with it."""
        while True:
            time.sleep(min(max(0.0, self._decoder.wanted_s() - AWAKE_S), LONGEST_PAUSE_S))
            yield device.read(max(device.in_waiting, self._decoder.missing_bytes()))


def explain(port: str, error: Exception, was_open: bool) -> str:
    """What is wrong with the port, in words that say what to do."""
    number = getattr(error, "errno", None)
    if number is None and isinstance(error.__context__, termios.error):  # pyserial keeps only its text
        number = error.__context__.args[0]
    if number == errno.ENOENT and was_open:
        return f"{port} is gone: unplugged? Waiting for it to come back"
    if number == errno.ENOENT:
        return f"{port} does not exist yet: plug the sensor in or correct `source`. Waiting for it"
    if number in (errno.EACCES, errno.EPERM):
        user = os.environ.get("USER", "the service's user")
        return f"{port}: permission denied: add {user} to the group that owns it (usually dialout) and log in again"
    if number in (errno.EBUSY, errno.EAGAIN):
        return f"{port} is in use by another process: stop it (a login console or ModemManager, perhaps)"
    if number in (errno.ENOTTY, errno.EINVAL, errno.EISDIR):
        return f"{port} is no serial port: correct `source`"
    if was_open:
        return f"{port}: lost while reading: unplugged? Waiting for it to come back ({error})"
    return f"{port}: cannot be opened: {error}"
