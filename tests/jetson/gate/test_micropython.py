"""The MicroPython firmware, whole: its ``main`` runs here on a board of stand-ins whose time the test sets."""

from __future__ import annotations

import runpy
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from services.jetson.gate import frames
from services.jetson.gate.pipeline import Decision

FOLDER = Path(frames.__file__).parent / "firmware" / "micropython"
ENABLE, BUTTON, RECEIVER = 15, 14, 17
GO = Decision("GO", 5.0, 0.2, "verdict", "clear")
SLOW = Decision("SLOW", 0.5, 0.2, "verdict", "near")


class Switched(Exception):
    """The board is switched off: the test is over."""


class Board:
    """As much of ``machine`` as the firmware uses. ``step`` is called when it feeds the watchdog, once a round."""

    def __init__(self, step: Callable[[Board], None]) -> None:
        self.step, self.ms, self.rounds = step, 0, 0
        self.pins: dict[int, int] = {BUTTON: 1}
        self.throttle_us, self.rx, self.tx = 0, b"", b""
        self.edge: Callable[[Any], None] = lambda pin: None

    def module(self) -> ModuleType:
        machine, board = ModuleType("machine"), self

        class Pin:
            IN, OUT, PULL_UP, IRQ_RISING, IRQ_FALLING = range(5)

            def __init__(self, number: int, mode: int = 0, pull: int | None = None, value: int | None = None) -> None:
                self.number = number
                if value is not None:
                    board.pins[number] = value

            def value(self, new: bool | None = None) -> int:
                if new is not None:
                    board.pins[self.number] = int(new)
                return board.pins.get(self.number, 0)

            def irq(self, handler: Callable[[Any], None], edges: int) -> None:
                board.edge = lambda pin=self: handler(pin)

        machine.Pin = Pin  # type: ignore[attr-defined]
        machine.PWM = lambda pin, freq, duty_ns: SimpleNamespace(duty_ns=board.set_throttle)  # type: ignore[attr-defined]
        machine.UART = lambda number, baudrate: SimpleNamespace(  # type: ignore[attr-defined]
            any=lambda: len(board.rx), read=board.read, write=board.write
        )
        machine.WDT = lambda timeout: SimpleNamespace(feed=board.feed)  # type: ignore[attr-defined]
        return machine

    def set_throttle(self, ns: int) -> None:
        self.throttle_us = ns // 1000

    def read(self, count: int) -> bytes:
        data, self.rx = self.rx[:count], self.rx[count:]
        return data

    def write(self, data: bytes) -> None:
        self.tx += data

    def feed(self) -> None:
        self.rounds += 1
        self.step(self)

    def pulse(self, width_us: int) -> None:
        """The radio receiver's throttle pulse, ending now."""
        self.us = self.ms * 1000 - width_us
        self.pins[RECEIVER] = 1
        self.edge()  # type: ignore[call-arg]
        self.us = self.ms * 1000
        self.pins[RECEIVER] = 0
        self.edge()  # type: ignore[call-arg]

    us = 0


def run(monkeypatch: pytest.MonkeyPatch, step: Callable[[Board], None]) -> Board:
    """Run ``main.py`` until ``step`` raises ``Switched``."""
    board = Board(step)
    clock: dict[str, Callable[..., int]] = {
        "ticks_ms": lambda: board.ms,
        "ticks_us": lambda: board.us,
        "ticks_diff": lambda a, b: a - b,
    }
    for name, function in clock.items():  # MicroPython's time has them, CPython's does not
        monkeypatch.setattr(time, name, function, raising=False)
    monkeypatch.setitem(sys.modules, "machine", board.module())
    monkeypatch.delitem(sys.modules, "gate_receiver", raising=False)
    monkeypatch.syspath_prepend(str(FOLDER))
    with pytest.raises(Switched):
        runpy.run_path(str(FOLDER / "main.py"))
    monkeypatch.delitem(sys.modules, "gate_receiver", raising=False)
    return board


def test_the_board_obeys_limits_reports_and_stops_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[int, int]] = []  # (enable, throttle) of the round before
    reader = frames.ReportReader()

    def step(board: Board) -> None:
        board.ms = 20 * board.rounds
        board.pulse(1950)
        seen.append((board.pins[ENABLE], board.throttle_us))
        if board.rounds <= 60:
            board.rx += frames.permission_frame(board.rounds, GO, 0.2)
        elif board.rounds == 61:
            board.rx += frames.permission_frame(board.rounds, SLOW, 0.2)
        board.pins[BUTTON] = 0 if board.rounds == 65 else 1
        if board.rounds == 80:
            raise Switched

    board = run(monkeypatch, step)
    assert seen[1:40] == [(0, 1500)] * 39
    assert seen[58] == (1, 1800)  # 5 m/s at 60 us for 1 m/s
    assert seen[62] == (1, 1530)
    assert seen[-1] == (0, 1500)
    reports = reader.feed(board.tx)
    assert [r.permission for r in reports if r.why == "as told"][-1] == "SLOW"
    assert (reports[-1].why, reports[-1].presses) == ("frames stopped coming", 1)
