"""The devices that measure motion, each as an endless sequence of measurements; ``OSError`` when one is lost."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any, Protocol

import serial

from common.clock import monotonic_s
from common.config import ConfigError
from common.serial_port import PORT_ERRORS, explain
from common.source_url import SourceUrl
from services.jetson.ego.can_signals import CanSignals
from services.jetson.ego.config import EgoConfig
from services.jetson.ego.imu_chips import AXES, CHIPS, I2c, SmbusDevice, open_chip
from services.jetson.ego.line_protocol import LineReader
from services.jetson.ego.measurement import Measurement, Rejected
from services.jetson.ego.vesc import REQUEST, Values, VescReader
from services.jetson.ego.wheel import WheelEncoder

READ_TIMEOUT_S = 0.05
SILENT_S = 1.0  # a VESC that does not answer
Readings = Iterator[Measurement | Rejected]


class Device(Protocol):
    """``readings`` opens the device and reads until it is lost, which is an ``OSError`` with the reason."""

    origin: str

    def readings(self) -> Readings:
        """Open the device and read it until it is lost."""


class SerialLines:
    """``serial:/dev/ttyACM1?baud=115200``: the line protocol of a microcontroller."""

    origin = "serial"

    def __init__(self, url: SourceUrl) -> None:
        self._url, self._baud, self._was_open = url, int(url.number("baud", 115200)), False

    def readings(self) -> Readings:
        """Measurements of the lines as they come. Raises ``OSError``: the port is lost."""
        reader = LineReader()
        try:
            with serial.Serial(self._url.target, self._baud, timeout=READ_TIMEOUT_S, exclusive=True) as port:
                self._was_open = True
                while True:
                    yield from reader.feed(monotonic_s(), port.read(max(1, port.in_waiting)))
        except PORT_ERRORS as error:
            raise OSError(explain(self._url.target, error, self._was_open)) from None


class Vesc:
    """``vesc:/dev/ttyACM1?baud=115200``: asks the motor controller for its values, over and over."""

    origin = "vesc"

    def __init__(self, url: SourceUrl, config: EgoConfig) -> None:
        self._url, self._baud, self._was_open = url, int(url.number("baud", 115200)), False
        self._config = config.vesc

    def readings(self) -> Readings:
        """Speed and battery, asked for every ``vesc.period_s``. Raises ``OSError``: the port is lost."""
        try:
            with serial.Serial(self._url.target, self._baud, timeout=self._config.period_s, exclusive=True) as port:
                self._was_open = True
                yield from self._ask(port)
        except PORT_ERRORS as error:
            raise OSError(explain(self._url.target, error, self._was_open)) from None

    def _ask(self, port: Any) -> Readings:
        reader, answered_s = VescReader(), monotonic_s()
        while True:
            asked_s = monotonic_s()
            port.write(REQUEST)
            for one in reader.feed(port.read(max(1, port.in_waiting))):
                answered_s = monotonic_s()
                yield self._measurement(answered_s, one) if isinstance(one, Values) else one
            if monotonic_s() - answered_s > SILENT_S:
                yield Rejected("vesc", "no answer")
                answered_s = monotonic_s()
            time.sleep(max(0.0, self._config.period_s - (monotonic_s() - asked_s)))

    def _measurement(self, at_s: float, values: Values) -> Measurement:
        speed_mps = values.erpm / self._config.erpm_per_mps
        return Measurement(at_s, "vesc", speed_mps=speed_mps, battery_v=values.battery_v)


class CanBus:
    """``can:can0``: signals of a DBC file, see ``[can]``. Raises ``ConfigError``: no library, no such signal."""

    origin = "can"

    def __init__(self, url: SourceUrl, config: EgoConfig) -> None:
        try:
            import can
        except ImportError:
            raise ConfigError(f"source {url}: library python-can is missing: install the extra vehicle") from None
        if config.can.interface not in can.VALID_INTERFACES:
            known = ", ".join(sorted(can.VALID_INTERFACES))
            raise ConfigError(f"[can] interface = {config.can.interface!r}: python-can has {known}")
        self._can, self._url, self._config = can, url, config.can
        self._signals = CanSignals(config.can)

    def readings(self) -> Readings:
        """A measurement of each frame that carries a known signal. Raises ``OSError``: the interface is lost."""
        filters = [{"can_id": one, "can_mask": 0x1FFFFFFF} for one in self._signals.frame_ids]
        try:
            with self._can.Bus(channel=self._url.target, interface=self._config.interface, can_filters=filters) as bus:
                while True:
                    frame = bus.recv(READ_TIMEOUT_S)
                    if frame is None or frame.is_error_frame or frame.is_remote_frame:
                        continue
                    one = self._signals.measure(monotonic_s(), frame.arbitration_id, bytes(frame.data))
                    if one is not None:
                        yield one
        except (self._can.CanError, OSError, ValueError) as error:
            raise OSError(f"{self._url}: {error}; is the interface up?") from None


class Imu:
    """``imu:mpu6050?bus=1&address=0x68``: the yaw rate of a gyroscope, raw: its bias is the pipeline's."""

    origin = "imu"

    def __init__(self, url: SourceUrl, config: EgoConfig, open_bus: Callable[[int, int], I2c] | None = None) -> None:
        if url.target not in CHIPS:
            raise ConfigError(f"source {url}: no chip {url.target!r}; there are: {', '.join(CHIPS)}")
        self._url, self._config, self._chip = url, config.imu, CHIPS[url.target]
        self._bus_number, self._stuck_s = int(url.number("bus", 1)), config.limits.stuck_s
        try:
            self._address = int(url.params.get("address", str(self._chip.address)), 0)
        except ValueError:
            raise ConfigError(f"source {url}: address={url.params['address']!r} is not a number") from None
        self._open_bus = open_bus or SmbusDevice

    def readings(self) -> Readings:
        """The yaw rate in rad/s at the chip's own rate. Raises ``OSError``: the chip does not answer."""
        place = f"{self._chip.name} at 0x{self._address:02x} of I2C bus {self._bus_number}"
        try:
            with closing(self._open_bus(self._bus_number, self._address)) as bus:  # each attempt opens it anew
                open_chip(self._chip, bus, time.sleep)
                yield from self._rates(bus)
        except OSError as error:
            raise OSError(f"{place}: {error}") from None

    def _rates(self, bus: I2c) -> Readings:
        """Until the rates about all axes stay the same: a chip that lost its power for a moment answers, asleep."""
        last, since_s = self._chip.read(bus), monotonic_s()
        while True:
            rates, now_s = self._chip.read(bus), monotonic_s()
            yield self._reading(now_s, rates[AXES.index(self._config.axis)])
            if rates != last:
                last, since_s = rates, now_s
            if now_s - since_s > self._stuck_s:
                raise OSError(f"the same rates for {now_s - since_s:.1f} s, has it lost its power? Setting it up again")
            time.sleep(self._chip.sample_s)

    def _reading(self, at_s: float, raw: int) -> Measurement | Rejected:
        if abs(raw) >= self._chip.full_scale:
            return Rejected("imu", "saturated")
        return Measurement(at_s, "imu", yaw_rate_radps=self._config.sign * raw * self._chip.radps_per_lsb)


class EdgeSource(Protocol):
    """Edges of some lines: (monotonic seconds, GPIO number, rising). ``OSError`` when the chip is lost."""

    def wait(self, timeout_s: float) -> list[tuple[float, int, bool]]:
        """The edges since the last call; none when the time is over first."""

    def close(self) -> None:
        """Release the lines."""


class GpioEdges:
    """Edges through libgpiod 2 (extra ``vehicle``), with the kernel's own monotonic time stamps."""

    def __init__(self, chip: str, lines: tuple[int, ...]) -> None:
        """Raises ``OSError``: library, chip or line missing, or in use."""
        try:
            import gpiod
            import gpiod.line
        except ImportError:
            raise OSError("library gpiod is missing: install the extra vehicle") from None
        line = gpiod.line
        settings = gpiod.LineSettings(edge_detection=line.Edge.BOTH, bias=line.Bias.PULL_UP)
        self._rising = gpiod.EdgeEvent.Type.RISING_EDGE
        try:
            self._request: Any = gpiod.request_lines(chip, consumer="spotter-ego", config={lines: settings})
        except FileNotFoundError:
            raise OSError(f"{chip} does not exist: `gpioinfo` lists the chips") from None
        except PermissionError:
            raise OSError(f"{chip}: this user is not in group gpio") from None

    def wait(self, timeout_s: float) -> list[tuple[float, int, bool]]:
        if not self._request.wait_edge_events(timeout_s):
            return []
        events = self._request.read_edge_events()
        return [(one.timestamp_ns * 1e-9, one.line_offset, one.event_type == self._rising) for one in events]

    def close(self) -> None:
        self._request.release()


class Encoder:
    """``gpio:/dev/gpiochip0?a=5&b=6``: a wheel encoder of one or two channels."""

    origin = "encoder"

    def __init__(
        self,
        url: SourceUrl,
        config: EgoConfig,
        open_edges: Callable[[str, tuple[int, ...]], EdgeSource] = GpioEdges,
    ) -> None:
        if "a" not in url.params:
            raise ConfigError(f"source {url}: expected the line of channel a, e.g. gpio:/dev/gpiochip0?a=5")
        self._url, self._config, self._open_edges = url, config, open_edges
        names = [name for name in ("a", "b") if name in url.params]
        self._channels = {int(url.number(name, 0)): name for name in names}
        if len(self._channels) < len(names) or min(self._channels) < 0:
            raise ConfigError(f"source {url}: expected {' and '.join(names)} to be different lines, 0 or more")

    def readings(self) -> Readings:
        """Speed in m/s and its sigma, 20 times a second or more. Raises ``OSError``: the lines are lost."""
        wheel = WheelEncoder(self._config.encoder, two=len(self._channels) == 2)
        rejected = {"bounced": 0, "missed": 0}
        try:
            with closing(self._open_edges(self._url.target, tuple(self._channels))) as edges:
                while True:
                    for at_s, line, rising in edges.wait(READ_TIMEOUT_S):
                        wheel.edge(at_s, self._channels[line], rising=rising)
                    yield from self._since(wheel, rejected)
        except OSError as error:
            raise OSError(f"{self._url}: {error}") from None

    def _since(self, wheel: WheelEncoder, rejected: dict[str, int]) -> Readings:
        """The speed now, and what was rejected since the last time."""
        for what, count in (("bounced", wheel.bounced), ("missed", wheel.missed)):
            if count != rejected[what]:
                rejected[what] = count
                yield Rejected("encoder", f"edge {what}")
        if wheel.silent_channel:
            yield Rejected("encoder", f"channel {wheel.silent_channel} is silent")
            return  # half of a quadrature signal is no speed
        now_s = monotonic_s()
        speed, sigma = wheel.speed(now_s)
        yield Measurement(now_s, "encoder", speed_mps=speed, speed_sigma_mps=sigma)
