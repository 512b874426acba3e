"""Where the motion comes from: the simulated world, or one or more devices, each read in a thread of its own."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Generator, Iterator, Sequence

from common.backoff import Backoff
from common.bus.status import Report
from common.clock import monotonic_s, utc_at
from common.config import ConfigError
from common.pacing import ticks
from common.ros2.source import ROS2_PARAMETERS, require_rosbags
from common.source_url import SourceUrl, parse_source
from services.jetson.ego.config import EgoConfig
from services.jetson.ego.devices import CanBus, Device, Encoder, Imu, SerialLines, Vesc
from services.jetson.ego.measurement import Measurement, Rejected
from services.jetson.ego.pipeline import Motion, Odometer

log = logging.getLogger(__name__)

AND = " + "  # between the URLs of several devices
SCHEMES: dict[str, tuple[str, ...]] = {
    "sim": ("t0",),
    "gpio": ("a", "b"),
    "serial": ("baud",),
    "vesc": ("baud",),
    "can": (),
    "imu": ("bus", "address"),
    "ros2": ROS2_PARAMETERS,
}
MAX_WAITING = 2000  # measurements; a reader that is that far behind drops new ones
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.2, 2.0


def open_source(config: EgoConfig, report: Report | None = None) -> Iterator[tuple[int, Motion]]:
    """Yield ``(stamp_ns, motion)`` at the configured rate, for ever. Nothing is opened before the first.

    Raises:
        ConfigError: no source, an unknown scheme or scenario, or a device that cannot be set up as it is written.
    """
    urls = urls_of(config)
    period_s = 1.0 / config.rate_hz
    if any(url.scheme == "sim" for url in urls):
        if len(urls) > 1:
            raise ConfigError(f"source {config.source!r}: the simulated motion stands alone")
        return _simulated(urls[0], period_s)
    report = report or Report("ego")
    devices = [_device(url, config, report) for url in urls]
    origins = [device.origin for device in devices]
    if len(set(origins)) < len(origins):
        raise ConfigError(f"source {config.source!r}: at most one of each kind")
    return measured(devices, config, report)


def urls_of(config: EgoConfig) -> list[SourceUrl]:
    """The source's parts, without opening any.

    Raises:
        ConfigError: no source, an unknown scheme or parameter.
    """
    return [parse_source(text, SCHEMES) for text in config.source.split(AND)]


def _device(url: SourceUrl, config: EgoConfig, report: Report) -> Device:
    match url.scheme:
        case "gpio":
            return Encoder(url, config)
        case "serial":
            return SerialLines(url)
        case "vesc":
            return Vesc(url, config)
        case "can":
            return CanBus(url, config)
        case "ros2":
            require_rosbags(url)
            from services.jetson.ego.ros2 import RosMotion

            return RosMotion(url, config.zenoh, config.imu, report)
    return Imu(url, config)


def measured(devices: Sequence[Device], config: EgoConfig, report: Report) -> Generator[tuple[int, Motion], None, None]:
    """What the devices say, combined at the configured rate. A lost device is tried again, and named meanwhile."""
    odometer = Odometer(config, [device.origin for device in devices])
    readers = [Reader(device) for device in devices]
    try:
        for _ in ticks(1.0 / config.rate_hz):
            now_s = monotonic_s()
            for reader in readers:
                for one in reader.take():
                    faults = odometer.take(one) if isinstance(one, Measurement) else [f"{one.origin} {one.what}"]
                    for fault in faults:
                        report.bad_input(fault)
            lost = {reader.origin: reader.lost for reader in readers if reader.lost}
            yield utc_at(now_s), odometer.motion(now_s, lost)
    finally:
        for reader in readers:
            reader.close()


class Reader:
    """Reads one device in a thread until ``close``; ``lost`` is the reason while it is away."""

    def __init__(self, device: Device) -> None:
        self.origin, self.lost = device.origin, ""
        self._device = device
        self._queue: queue.Queue[Measurement | Rejected] = queue.Queue(MAX_WAITING)
        self._stop = threading.Event()
        threading.Thread(target=self._run, name=device.origin, daemon=True).start()

    def take(self) -> list[Measurement | Rejected]:
        """Everything since the last call."""
        taken = []
        while not self._queue.empty():
            taken.append(self._queue.get_nowait())
        return taken

    def close(self) -> None:
        """Leave the device with its next reading, and do not open it again."""
        self._stop.set()

    def _run(self) -> None:
        backoff = Backoff(FIRST_PAUSE_S, LONGEST_PAUSE_S)
        while not self._stop.is_set():
            try:
                for one in self._device.readings():
                    if self._stop.is_set():
                        return
                    self.lost = ""
                    backoff.reset()
                    if not self._queue.full():
                        self._queue.put_nowait(one)
                self.lost = f"{self.origin}: ended"
            except OSError as error:
                if str(error) != self.lost:
                    log.warning("%s", error)
                self.lost = str(error)
            except Exception as error:  # a dead thread would leave "no data yet" for ever
                reason = f"{self.origin}: cannot be read: {type(error).__name__}: {error}"
                if reason != self.lost:
                    log.exception("%s", reason)
                self.lost = reason
            self._stop.wait(backoff.next_s())


def _simulated(url: SourceUrl, period_s: float) -> Iterator[tuple[int, Motion]]:
    from spotter_sim import odometry
    from spotter_sim.scenario_clock import ScenarioClock
    from spotter_sim.world import world_at

    clock = ScenarioClock(url)
    return (
        (utc_at(due_s), Motion(*odometry.measure(world_at(clock.scenario, clock.at(due_s)))))
        for due_s in ticks(period_s)
    )
