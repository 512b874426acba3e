"""The devices with their other ends emulated: a pseudo-terminal, registers, a virtual CAN bus, edges by the clock."""

from __future__ import annotations

import contextlib
import itertools
import os
import pty
import sys
import threading
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from common.bus.status import Report
from common.clock import monotonic_s
from common.source_url import parse_source, source_kind
from services.jetson.ego.config import CanConfig, EgoConfig, EncoderConfig, LimitsConfig, VescConfig
from services.jetson.ego.devices import CanBus, Device, Encoder, GpioEdges, Imu, SerialLines, Vesc
from services.jetson.ego.imu_chips import CHIPS
from services.jetson.ego.line_protocol import Line, line_of
from services.jetson.ego.pipeline import Motion
from services.jetson.ego.source import SCHEMES, measured
from services.jetson.ego.vesc import REQUEST
from tests.jetson.ego.imu_emulator import EmulatedImu
from tests.jetson.ego.test_wire import DBC, answer

Until = Callable[..., None]


class Watch:
    """What the service would publish, as it goes on in a thread."""

    def __init__(self, device: Device, config: EgoConfig | None = None) -> None:
        self.report = Report("x")
        self.motion = Motion(None, None)
        self._config = config or EgoConfig(rate_hz=100.0)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(device,), daemon=True)
        self._thread.start()

    def _run(self, device: Device) -> None:
        with contextlib.closing(measured([device], self._config, self.report)) as motions:
            for _, self.motion in motions:
                if self._stop.is_set():
                    return

    def close(self) -> None:
        self._stop.set()
        self._thread.join()

    def counted(self, what: str) -> int:
        return self.report.snapshot().counters.get(what, 0)


class Terminal:
    """A pseudo-terminal whose far end repeats ``say(n)`` every 10 ms, and keeps what it was told."""

    def __init__(self, say: Callable[[int], bytes]) -> None:
        self.say, self.received = say, b""
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.device = os.ttyname(self._slave)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Terminal:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)

    def _run(self) -> None:
        count = 0
        while not self._stop.wait(0.01):
            count += 1
            with contextlib.suppress(BlockingIOError):
                self.received += os.read(self._master, 4096)
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, self.say(count))


def lines(count: int) -> bytes:
    return line_of(Line(count % 256, 1500 + count % 5, -20, 100, 11800))


@pytest.fixture
def watch() -> Iterator[Callable[..., Watch]]:
    started: list[Watch] = []

    def start(*arguments: Any) -> Watch:
        started.append(Watch(*arguments))
        return started[-1]

    yield start
    for one in started:
        one.close()


def test_a_microcontroller_that_comes_late_lies_and_is_pulled(tmp_path: Path, watch: Any, until: Until) -> None:
    link = tmp_path / "tty"
    seen = watch(SerialLines(parse_source(f"serial:{link}", SCHEMES)))
    until(lambda: "does not exist yet" in seen.motion.reason, "absent")
    with Terminal(lines) as terminal:
        link.symlink_to(terminal.device)
        until(lambda: seen.motion.speed_mps is not None, "speed")
        assert seen.motion.speed_mps == pytest.approx(1.5, abs=0.01)
        assert seen.motion.steering_rad == pytest.approx(0.1)
        assert (seen.motion.speed_origin, seen.motion.reason) == ("serial", "")
        terminal.say = lambda count: b"\xff$SPOT,rubbish\n"
        until(lambda: seen.counted("serial nonsense"), "nonsense")
        until(lambda: seen.motion.speed_mps is None, "unknown")
        assert "silent" in seen.motion.reason
        terminal.say = lambda count: lines(7)
        until(lambda: seen.counted("serial repeated"), "a stuck buffer")
        terminal.say = lambda count: line_of(Line(count % 256, 90_000))
        until(lambda: seen.motion.reason == "serial speed nonsense: not used", "impossible")
        terminal.say = lines
        until(lambda: seen.motion.speed_mps is not None, "well again")
    until(lambda: "unplugged" in seen.motion.reason or "exist" in seen.motion.reason, "pulled")
    until(lambda: seen.motion.speed_mps is None, "unknown soon after")


def test_a_failure_that_nobody_foresaw_is_told_and_tried_again(watch: Any, until: Until) -> None:
    """A baud rate that no port has is a ValueError of pyserial, a port that goes while it is set up a termios.error."""
    with Terminal(lines) as terminal:
        device = SerialLines(parse_source(f"serial:{terminal.device}?baud=-9600", SCHEMES))
        seen = watch(device)
        until(lambda: "serial: cannot be read: ValueError: Not a valid baudrate: -9600" in seen.motion.reason, "told")
        device._baud = 115200
        until(lambda: seen.motion.speed_mps is not None, "tried again")


def test_a_vesc_is_asked_and_answers(watch: Any, until: Until) -> None:
    config = EgoConfig(rate_hz=100.0, vesc=VescConfig(erpm_per_mps=4600.0, period_s=0.01))
    with Terminal(lambda count: answer(9200 + count % 7, 118)) as terminal:
        seen = watch(Vesc(parse_source(f"vesc:{terminal.device}", SCHEMES), config), config)
        until(lambda: seen.motion.speed_mps is not None, "speed")
        assert seen.motion.speed_mps == pytest.approx(2.0, abs=0.01)
        assert seen.motion.battery_v == pytest.approx(11.8)
        until(lambda: REQUEST in terminal.received, "it was asked")
        terminal.say = lambda count: b""
        until(lambda: seen.counted("vesc no answer"), "no answer")
        assert seen.motion.speed_mps is None
        assert "silent" in seen.motion.reason


def test_a_source_that_is_closed_leaves_its_device_alone(until: Until) -> None:
    with Terminal(lines) as terminal:
        motions = measured([SerialLines(parse_source(f"serial:{terminal.device}", SCHEMES))], EgoConfig(), Report("x"))
        until(lambda: next(motions)[1].speed_mps is not None, "speed")
        motions.close()
        until(lambda: not any(thread.name == "serial" for thread in threading.enumerate()), "its thread has ended")


def test_signals_on_a_virtual_can_bus(tmp_path: Path, watch: Any, until: Until) -> None:
    can = pytest.importorskip("can")
    pytest.importorskip("cantools")
    (tmp_path / "car.dbc").write_text(DBC)
    signals = CanConfig(dbc=str(tmp_path / "car.dbc"), interface="virtual", speed="Motion.WheelSpeed")
    config = EgoConfig(rate_hz=100.0, can=signals)
    with can.Bus(channel="ego-test", interface="virtual") as sender:
        seen = watch(CanBus(parse_source("can:ego-test", SCHEMES), config), config)

        def arrives(value: int, length: int = 8) -> bool:
            data = value.to_bytes(2, "little", signed=True) + bytes(6)
            sender.send(can.Message(arbitration_id=256, data=data[:length], is_extended_id=False))
            sender.send(can.Message(arbitration_id=999, data=b"other", is_extended_id=False))
            return seen.motion.speed_mps == pytest.approx(value * 0.01 / 3.6, abs=1e-6)

        until(lambda: arrives(720), "2 m/s")
        until(lambda: arrives(0, length=1) or seen.counted("can nonsense"), "a frame that is too short")


def test_a_can_interface_that_is_not_there(tmp_path: Path, watch: Any, until: Until) -> None:
    pytest.importorskip("can")
    pytest.importorskip("cantools")
    (tmp_path / "car.dbc").write_text(DBC)
    config = EgoConfig(can=CanConfig(dbc=str(tmp_path / "car.dbc"), speed="Motion.WheelSpeed"))
    seen = watch(CanBus(parse_source("can:nocan9", SCHEMES), config), config)
    until(lambda: "can:nocan9" in seen.motion.reason, "named")


def test_a_gyroscope_turns_saturates_sticks_and_is_unplugged(watch: Any, until: Until) -> None:
    rate = {"dps": 20.0, "noise": 0.1}
    flip = [1.0]

    def turning() -> tuple[float, float, float]:
        flip[0] = -flip[0]
        return 0.0, 0.0, rate["dps"] + flip[0] * rate["noise"]

    chip = EmulatedImu("mpu6050", turning)
    config = EgoConfig(rate_hz=100.0)
    seen = watch(Imu(parse_source("imu:mpu6050?bus=3", SCHEMES), config, lambda bus, address: chip), config)
    until(lambda: seen.motion.yaw_rate_radps is not None, "yaw rate")
    assert seen.motion.yaw_rate_radps == pytest.approx(0.349, abs=0.01)
    assert seen.motion.yaw_rate_origin == "imu"
    rate["dps"] = 3000.0
    until(lambda: seen.counted("imu saturated"), "saturated")
    rate.update(dps=0.0, noise=0.0)
    until(lambda: seen.motion.reason == "imu yaw_rate stuck: not used", "stuck at zero")
    chip.present = False
    until(lambda: "mpu6050 at 0x68 of I2C bus 3: [Errno 121]" in seen.motion.reason, "unplugged")
    chip.present = True
    rate.update(dps=20.0, noise=0.1)
    until(lambda: seen.motion.reason == "", "well again")


@pytest.mark.parametrize("name", CHIPS)
def test_a_gyroscope_that_lost_its_power_for_a_moment_is_set_up_again(name: str, watch: Any, until: Until) -> None:
    flip = itertools.cycle((-0.5, 0.5))
    chip = EmulatedImu(name, lambda: (0.0, 0.0, 20.0 + next(flip)))
    config = EgoConfig(rate_hz=100.0, limits=LimitsConfig(stuck_s=0.3))
    seen = watch(Imu(parse_source(f"imu:{name}", SCHEMES), config, lambda bus, address: chip), config)
    until(lambda: seen.motion.yaw_rate_radps is not None, "yaw rate")
    chip.lose_power()
    until(lambda: "the same rates for 0.3 s, has it lost its power?" in seen.motion.reason, "told")
    until(lambda: seen.motion.yaw_rate_radps == pytest.approx(0.349, abs=0.02), "set up again")


class Wheel:
    """Edges of a turning wheel, as they come by the clock."""

    def __init__(self) -> None:
        self.speed_mps, self.lost = 1.0, False
        self._turned, self._last_s, self._done = 0.0, monotonic_s(), 0

    def wait(self, timeout_s: float) -> list[tuple[float, int, bool]]:
        threading.Event().wait(0.01)
        if self.lost:
            raise OSError("No such device")
        now_s = monotonic_s()
        before, self._turned = self._turned, self._turned + self.speed_mps * 400.0 * (now_s - self._last_s)
        begin_s, self._last_s = self._last_s, now_s
        edges = []
        while self._done < int(self._turned):
            share = (self._done + 1 - before) / max(self._turned - before, 1e-9)
            line, rising = [(5, True), (6, True), (5, False), (6, False)][self._done % 4]
            edges.append((begin_s + share * (now_s - begin_s), line, rising))
            self._done += 1
        return edges

    def close(self) -> None:
        return


def test_an_encoder_turns_stands_and_is_lost(watch: Any, until: Until) -> None:
    wheel = Wheel()
    config = EgoConfig(rate_hz=100.0, encoder=EncoderConfig(zero_after_s=0.2))
    url = parse_source("gpio:/dev/gpiochip0?a=5&b=6", SCHEMES)
    seen = watch(Encoder(url, config, lambda chip, lines: wheel), config)
    until(lambda: seen.motion.speed_mps == pytest.approx(1.0, rel=0.1), "turns")
    wheel.speed_mps = 0.0
    until(lambda: seen.motion.speed_mps == 0.0, "stands")
    wheel.lost = True
    until(lambda: "No such device" in seen.motion.reason, "lost")
    until(lambda: seen.motion.speed_mps is None, "unknown, not standing")


def test_libgpiod_is_asked_for_edges(monkeypatch: pytest.MonkeyPatch) -> None:
    """The calls to gpiod and what they return; the other end is a stand-in, since this machine has no chip."""
    asked: list[Any] = []
    event = SimpleNamespace(timestamp_ns=2_500_000_000, line_offset=5, event_type="rise")
    request = SimpleNamespace(
        wait_edge_events=lambda timeout: timeout > 0,
        read_edge_events=lambda: [event],
        release=lambda: asked.append("x"),
    )
    gpiod, line = ModuleType("gpiod"), ModuleType("gpiod.line")
    line.Edge, line.Bias = SimpleNamespace(BOTH="both"), SimpleNamespace(PULL_UP="up")  # type: ignore[attr-defined]
    gpiod.line, gpiod.LineSettings = line, SimpleNamespace  # type: ignore[attr-defined]
    gpiod.EdgeEvent = SimpleNamespace(Type=SimpleNamespace(RISING_EDGE="rise"))  # type: ignore[attr-defined]
    gpiod.request_lines = lambda chip, consumer, config: asked.append((chip, config)) or request  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "gpiod", gpiod)
    monkeypatch.setitem(sys.modules, "gpiod.line", line)
    edges = GpioEdges("/dev/gpiochip0", (5, 6))
    assert (edges.wait(0.0), edges.wait(0.1)) == ([], [(2.5, 5, True)])
    edges.close()
    assert asked[0][0] == "/dev/gpiochip0"
    assert vars(asked[0][1][(5, 6)]) == {"edge_detection": "both", "bias": "up"}


def test_what_kind_of_source_each_is() -> None:
    assert {source_kind(f"{scheme}:x") for scheme in ("gpio", "serial", "vesc", "can", "imu")} == {"live"}
    assert source_kind("gpio:/dev/gpiochip0?a=5 + imu:bno055") == "live"
    assert source_kind("gpio:/dev/gpiochip0?a=5 + sim:empty") == "simulated"
