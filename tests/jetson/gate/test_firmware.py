"""The Arduino firmware, complete, compiled for this machine with a small board around it; the Python twin beside it."""

from __future__ import annotations

import random
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from services.jetson.gate import frames
from services.jetson.gate.firmware.micropython.gate_receiver import GateReceiver
from services.jetson.gate.pipeline import Decision

BOARD = Path(__file__).parent / "board"
SKETCH = Path(frames.__file__).parent / "firmware" / "gate_uno_r4"
GO = Decision("GO", 5.0, 0.2, "verdict", "clear")
SLOW = Decision("SLOW", 0.5, 0.15, "verdict", "near")
STOP = Decision("STOP", 0.0, 0.0, "stale", "old")


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler here; its twin in Python is tested in test_frames.py")
    out = tmp_path_factory.mktemp("firmware") / "gate"
    warnings = ["-Wall", "-Wextra", "-Werror"]
    command = [compiler, "-std=c++17", *warnings, f"-I{BOARD}", f"-I{SKETCH}", str(BOARD / "main.cpp"), "-o", str(out)]
    subprocess.run(command, check=True)
    return out


class Board:
    """The running firmware: one round of its loop at a time."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.sent = b""

    def round(self, now_ms: int, data: bytes = b"", throttle_us: int = 1500, button: int = 0) -> dict[str, int]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{now_ms} {throttle_us} {button} {data.hex() or '-'}\n")
        self._process.stdin.flush()
        *numbers, hexes = self._process.stdout.readline().split()
        self.sent = bytes.fromhex("" if hexes == "-" else hexes)
        names = ("enable", "led", "servo_us", "permission", "limit", "why", "refused")
        return dict(zip(names, map(int, numbers), strict=True))


@pytest.fixture
def board(program: Path) -> Iterator[Board]:
    with subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield Board(process)
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait(5.0) == 0  # the watchdog was started


def frames_of(decision: Decision) -> Callable[[int], bytes]:
    return lambda seq: frames.permission_frame(seq, decision, 0.2)


def test_enable_and_throttle_follow_the_permission(board: Board) -> None:
    state = {}
    for i in range(60):
        state = board.round(20 * i, frames_of(GO)(i), throttle_us=1950)
        assert i >= 50 or (state["enable"], state["servo_us"]) == (0, 1500)
    assert (state["enable"], state["led"], state["servo_us"]) == (1, 1, 1800)  # 5 m/s at 60 us for 1 m/s
    state = board.round(1210, frames_of(SLOW)(60), throttle_us=1950)
    assert (state["enable"], state["led"], state["servo_us"]) == (1, 0, 1530)
    assert board.round(1220, throttle_us=1000)["servo_us"] == 1470  # reverse too
    assert board.round(1360, throttle_us=1950)["enable"] == 1
    state = board.round(1361, throttle_us=1950)
    assert (state["enable"], state["servo_us"], state["why"]) == (0, 1500, 2)


def test_the_radio_may_go_silent(board: Board) -> None:
    for i in range(60):
        board.round(20 * i, frames_of(GO)(i), throttle_us=1700)
    state = board.round(1200, frames_of(GO)(60), throttle_us=5000)  # no such pulse
    assert state["servo_us"] == 1700
    assert board.round(1290, frames_of(GO)(61), throttle_us=5000)["servo_us"] == 1500


def test_it_reports_and_counts_the_button(board: Board) -> None:
    reader = frames.ReportReader()
    board.round(0, frames_of(STOP)(7))
    (report,) = reader.feed(board.sent)
    assert (report.seq, report.permission, report.why, report.presses) == (7, "STOP", "as told", 0)
    board.round(50, button=1)
    assert board.sent == b""
    board.round(55, button=0)  # bounces
    board.round(101, button=1)
    (report,) = reader.feed(board.sent)
    assert report.presses == 1


def test_both_firmwares_do_the_same_with_the_same_bytes(board: Board) -> None:
    """Good, damaged, repeated, missing and random frames, with pauses; also across the wrap of ``millis``."""
    dice, twin = random.Random(1), GateReceiver()
    seq, now_ms, moved = 0, 2**32 // 1000 - 70_000, 0
    wrap_ms = 2**32 // 1000  # the board's micros wrap here, and with it its millis: stay below
    while now_ms < wrap_ms - 100 and seq < 3000:
        now_ms += dice.choice([5, 10, 20, 20, 20, 60] + [260] * (dice.random() < 0.02))
        seq += dice.choice([1, 1, 1, 1, 1, 1, 0, 2, -3] if dice.random() < 0.1 else [1])
        decision = dice.choice([GO, GO, GO, SLOW, STOP]) if dice.random() < 0.1 else GO
        data = bytearray(frames_of(decision)(seq))
        if dice.random() < 0.03:
            data[dice.randrange(len(data))] ^= 1 << dice.randrange(8)
        if dice.random() < 0.03:
            data = bytearray(dice.randbytes(dice.randrange(30)))
        state = board.round(now_ms, bytes(data))
        for byte in data:
            twin.feed(byte, now_ms)
        twin.tick(now_ms)
        moved += twin.permission != 0
        got = (state["permission"], state["limit"], state["why"], state["refused"])
        assert got == (twin.permission, twin.limit_mm_s, twin.why, twin.refused), now_ms
        if board.sent:
            assert board.sent[-10:-2] == twin.report(0)[:8]
    assert moved > 100
