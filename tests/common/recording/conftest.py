"""What the tests of recordings share: messages, files of them, a recorder that is fed."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from common.codec import encode
from common.messages import LidarZone, LidarZones, Message, Verdict
from common.recording.file import RecordingFile
from common.recording.recorder import DiskFull, Recorder

KEY = "jetson0/fusion/verdict"
BUDGET_S = 60.0


def add_message(file: RecordingFile, key: str, message: Message, log_ns: int) -> None:
    file.add(key, type(message), encode(message), log_ns, message.sent_ns, message.seq)


def make_verdict(stamp_ns: int, seq: int = 0) -> Verdict:
    return Verdict(
        stamp_ns=stamp_ns, seq=seq, level="CAUTION", rule="R1", because="test", inputs={}, confirmed=False,
        suppressed=False, advisory=None, blind=False, permission="SLOW",
    )  # fmt: skip


def make_zones(stamp_ns: int) -> LidarZones:
    zone = LidarZone(nearest_m=None, points=0, level="SAFE")
    return LidarZones(stamp_ns=stamp_ns, left=zone, centre=zone, right=zone, level="SAFE", raw_level="SAFE")


@pytest.fixture(scope="session")
def add() -> Callable[[RecordingFile, str, Message, int], None]:
    """``add(file, key, message, log_ns)``: one message, as the recorder adds it."""
    return add_message


@pytest.fixture(scope="session")
def verdict() -> Callable[..., Verdict]:
    """``verdict(stamp_ns, seq)``: a CAUTION."""
    return make_verdict


@pytest.fixture(scope="session")
def zones() -> Callable[[int], LidarZones]:
    """``zones(stamp_ns)``: nothing in any lane."""
    return make_zones


@pytest.fixture
def recording_of(tmp_path: Path) -> Callable[..., Path]:
    """``recording_of(count, flush_every)``: a file of so many verdicts, stamped and logged 1000, 1001, ..."""

    def make(count: int, flush_every: int = 0) -> Path:
        path = tmp_path / "a.mcap"
        with RecordingFile(path, {"spotter": {"version": "x"}}) as file:
            for i in range(count):
                add_message(file, KEY, make_verdict(1000 + i, i), 1000 + i)
                if flush_every and i % flush_every == 0:
                    file.flush()
        return path

    return make


@pytest.fixture(scope="session")
def run_recorder() -> Callable[[Recorder, Callable[[], object], int], None]:
    """``run_recorder(recorder, feed, expect)``: feed while it records; stop when so many messages are written."""

    def run(recorder: Recorder, feed: Callable[[], object], expect: int) -> None:
        stop, changed = threading.Event(), threading.Event()
        failures: list[DiskFull] = []

        def record() -> None:
            try:
                recorder.run(stop, lambda _: changed.set())
            except DiskFull as error:
                failures.append(error)

        thread = threading.Thread(target=record)
        thread.start()
        feed()
        deadline_s = time.monotonic() + BUDGET_S
        while recorder.status.messages < expect and time.monotonic() < deadline_s and not failures:
            changed.wait(0.05)
            changed.clear()
        stop.set()
        thread.join(BUDGET_S)
        if failures:
            raise failures[0]

    return run
