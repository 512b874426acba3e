"""The ways to the actuator: a terminal with the firmware's logic behind it, emulated lines, a virtual CAN bus."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from common.clock import monotonic_s
from common.config import ConfigError
from services.jetson.gate.config import GateConfig, LimitsConfig
from services.jetson.gate.emulator import EmulatedActuator
from services.jetson.gate.frames import CODES
from services.jetson.gate.gpio_lines import LineError, open_lines
from services.jetson.gate.output import Output, open_outputs
from services.jetson.gate.pipeline import STOPPED, Decision
from services.jetson.gate.sim_output import Brakes, SimulatedCar

pytestmark = [pytest.mark.system, pytest.mark.whole]  # real time at the actuator

Until = Callable[..., None]
GO = Decision("GO", 5.0, 0.2, "verdict", "clear")
SLOW = Decision("SLOW", 0.5, 0.2, "verdict", "near")


def output_of(url: str, limits: LimitsConfig | None = None) -> Output:
    (output,) = open_outputs(GateConfig(outputs=(url,), limits=limits or LimitsConfig(verdict_age_s=0.2)))
    return output


def sending(output: Output, decision: Decision, condition: Callable[[], object]) -> Callable[[], bool]:
    """For ``until``: a round of the gate's loop each time it is asked."""

    def one() -> bool:
        output.send(monotonic_s(), decision, 0)
        time.sleep(0.01)
        return bool(condition())

    return one


@pytest.fixture
def actuator() -> Iterator[EmulatedActuator]:
    with EmulatedActuator() as one:
        yield one


def test_frames_reach_the_actuator_and_its_reports_come_back(actuator: EmulatedActuator, until: Until) -> None:
    output = output_of(f"serial:{actuator.device}")
    assert "not opened yet" in output.fault(monotonic_s())
    until(sending(output, GO, lambda: actuator.permission == "GO"), "go")
    until(sending(output, GO, lambda: output.words() == "GO (as told)"), "the report")
    assert output.fault(monotonic_s()) == ""
    actuator.presses += 2
    until(sending(output, GO, lambda: output.presses() == 2), "the button")
    output.close()
    until(lambda: actuator.permission == "STOP", "stop at the end")


def test_an_actuator_that_hears_nothing_stops_and_says_so(actuator: EmulatedActuator, until: Until) -> None:
    output = output_of(f"serial:{actuator.device}")
    until(sending(output, GO, lambda: actuator.permission == "GO"), "go")
    until(lambda: actuator.permission == "STOP", "it stops by itself")
    stopped = actuator.changes[-1]
    assert stopped.at_s - actuator.accepted_s[-1] > 0.19  # the frame held for 0.2 s

    def says_so() -> bool:
        output.listen(monotonic_s())
        return "the actuator stopped by itself" in output.fault(monotonic_s())

    until(says_so, "its report")
    output.close()


def test_a_silent_and_a_disobedient_actuator_are_faults(actuator: EmulatedActuator, until: Until) -> None:
    output = output_of(f"serial:{actuator.device}")
    until(sending(output, GO, lambda: output.words() == "GO (as told)"), "go")
    actuator.answers = False
    until(sending(output, GO, lambda: "has not answered" in output.fault(monotonic_s())), "silence")
    actuator.answers = True
    until(sending(output, GO, lambda: output.words() == "GO (as told)"), "it is opened again by itself")
    actuator.receiver.feed = lambda byte, now_ms: True  # type: ignore[method-assign]
    actuator.receiver.tick = lambda now_ms: None  # type: ignore[method-assign]
    until(sending(output, STOPPED, lambda: "although it was told less" in output.fault(monotonic_s())), "disobedience")
    output.close()


def test_an_absent_port_is_named_and_looked_for(tmp_path: Path, until: Until) -> None:
    link = tmp_path / "tty"
    output = output_of(f"serial:{link}")
    output.send(monotonic_s(), STOPPED, 0)
    assert "does not exist yet" in output.fault(monotonic_s())
    with EmulatedActuator() as actuator:
        link.symlink_to(actuator.device)
        until(sending(output, GO, lambda: actuator.permission == "GO"), "it comes")
    until(sending(output, GO, lambda: output.fault(monotonic_s())), "it goes")
    output.close()


def lines_in(path: Path) -> list[tuple[float, int, int]]:
    rows = (line.split() for line in path.read_text().splitlines())
    return [(float(at_s), int(line), int(value)) for at_s, line, value in rows]


def test_pulses_while_it_may_move(tmp_path: Path) -> None:
    output = output_of(f"gpio:emulator:{tmp_path / 'lines'}?enable=17&full=27")
    for decision in (GO, GO, GO, SLOW, SLOW, STOPPED, STOPPED, GO):
        output.send(0.0, decision, 0)
    output.close()
    changes = [value for _, line, value in lines_in(tmp_path / "lines") if line == 17]
    assert changes == [0, 1, 0, 1, 0, 1, 0, 1, 0]
    assert [value for _, line, value in lines_in(tmp_path / "lines") if line == 27] == [0, 1, 0, 1, 0]


def test_without_a_second_line_slow_is_stop(tmp_path: Path) -> None:
    output = output_of(f"gpio:emulator:{tmp_path / 'lines'}?enable=17")
    for _ in range(3):
        output.send(0.0, SLOW, 0)
    output.close()
    assert {value for _, _, value in lines_in(tmp_path / "lines")} == {0}


def last_is(path: Path, value: int) -> bool:
    """The enable line was set to this value last; the emulator's file begins empty."""
    written = lines_in(path) if path.exists() else []
    return bool(written) and written[-1][1:] == (17, value)


def guarded(tmp_path: Path, until: Until) -> tuple[Any, Path]:
    """An output with a guard whose line is active."""
    path = tmp_path / "lines"
    output = output_of(f"gpio:emulator:{path}?enable=17&mode=level")
    until(sending(output, GO, lambda: last_is(path, 1)), "the line is active")
    return output, path


def test_the_guard_lets_go_when_the_gate_is_silent(tmp_path: Path, until: Until) -> None:
    output, path = guarded(tmp_path, until)
    until(lambda: last_is(path, 0), "inactive")
    output.close()


@pytest.mark.parametrize("signum", [signal.SIGSTOP, signal.SIGKILL])
def test_a_guard_that_freezes_or_dies_loses_its_line(tmp_path: Path, until: Until, signum: int) -> None:
    output, path = guarded(tmp_path, until)
    os.kill(output._port.pid, signum)
    until(sending(output, GO, lambda: last_is(path, 0)), "inactive")
    assert output.fault(monotonic_s())
    until(sending(output, GO, lambda: last_is(path, 1)), "a new guard")
    output.close()
    assert last_is(path, 0)


def test_libgpiod_is_asked_for_inactive_outputs(monkeypatch: pytest.MonkeyPatch) -> None:
    """The calls to gpiod and their order; the other end is a stand-in, since this machine has no chip."""
    calls: list[Any] = []
    request = SimpleNamespace(set_values=calls.append, release=lambda: calls.append("released"))
    gpiod, line = ModuleType("gpiod"), ModuleType("gpiod.line")
    line.Direction = SimpleNamespace(OUTPUT="out")  # type: ignore[attr-defined]
    line.Value = SimpleNamespace(ACTIVE=1, INACTIVE=0)  # type: ignore[attr-defined]
    gpiod.line, gpiod.LineSettings = line, SimpleNamespace  # type: ignore[attr-defined]
    gpiod.request_lines = lambda chip, consumer, config: calls.append((chip, config)) or request  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "gpiod", gpiod)
    monkeypatch.setitem(sys.modules, "gpiod.line", line)
    lines = open_lines("/dev/gpiochip0", (17, 27), active_low=True)
    lines.set({17: True})
    lines.close()
    (chip, config), *rest = calls
    assert (chip, rest) == ("/dev/gpiochip0", [{17: 1}, {17: 0, 27: 0}, "released"])
    assert vars(config[(17, 27)]) == {"direction": "out", "output_value": 0, "active_low": True}


def test_a_chip_that_is_not_there_is_named() -> None:
    pytest.importorskip("gpiod")
    with pytest.raises(LineError, match="/dev/gpiochip99"):
        open_lines("/dev/gpiochip99", (17,), active_low=False)


def test_permissions_on_a_virtual_can_bus() -> None:
    can = pytest.importorskip("can")
    with can.Bus(channel="gate-test", interface="virtual") as listener:
        output = output_of("can:gate-test?interface=virtual&id=200")
        for decision in (GO, STOPPED):
            output.send(0.0, decision, 0)
        assert output.fault(0.0) == ""
        output.close()
        frames = [listener.recv(1.0) for _ in range(3)]
    assert [(one.arbitration_id, one.data[1], one.data[2]) for one in frames] == [
        (200, 1, CODES["GO"]), (200, 2, CODES["STOP"]), (200, 3, CODES["STOP"]),
    ]  # fmt: skip


def test_a_can_interface_that_is_down_is_named() -> None:
    pytest.importorskip("can")
    output = output_of("can:nocan9")
    output.send(1.0, GO, 0)
    assert "can:nocan9" in output.fault(1.0)
    assert "ip link set nocan9 up" in output.fault(1.0)
    output.close()


def test_the_simulated_car_brakes() -> None:
    car = output_of("sim:?wanted=2&brake=4&accelerate=1")
    assert isinstance(car, SimulatedCar)
    now_s = 10.0
    for _ in range(200):
        now_s += 0.02
        car.send(now_s, GO, 0)
    assert car.speed_mps == pytest.approx(2.0)
    for _ in range(10):
        now_s += 0.02
        car.send(now_s, STOPPED, 0)
    assert car.speed_mps == pytest.approx(2.0 - 4.0 * 0.2)
    assert car.words() == "STOP (as told), simulated car at 1.2 m/s"


def test_brakes_refuse_nonsense() -> None:
    with pytest.raises(ValueError, match="expected more than 0"):
        Brakes(1.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("url", "error_text"),
    [
        ("bell:", "expected one of can:, gpio:, serial:, sim:"),
        ("gpio:/dev/gpiochip0", "expected the number of the line"),
        ("gpio:/dev/gpiochip0?enable=17&mode=wave", "expected pulse or level"),
        ("gpio:/dev/gpiochip0?enable=17&active=both", "expected high or low"),
        ("gpio:/dev/gpiochip0?enable=x", "is not a number"),
        ("serial:/dev/ttyACM0?parity=odd", "no parameter 'parity'"),
        ("can:can0?id=4096", "expected 0 to 2047"),
    ],
)
def test_wrong_outputs_are_refused(url: str, error_text: str) -> None:
    with pytest.raises(ConfigError, match=error_text):
        output_of(url)


def test_an_output_that_cannot_stop_in_time_is_refused_with_what_would() -> None:
    url = "gpio:/dev/gpiochip0?enable=17&hold=0.05"
    with pytest.raises(ConfigError, match=r"STOP after 0\.320 s, allowed 0\.3 s .*verdict_age_s = 0\.230"):
        output_of(url, LimitsConfig())
    output_of(url, LimitsConfig(verdict_age_s=0.23))
