"""How a service's process ends when it is stopped, also in the middle of compiled code."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

PROGRAM = """
import sys
from common.bus.service_app import run_until_stopped

def run():
    print("ready", flush=True)
    try:
        while True:
            pass
    except KeyboardInterrupt as interrupt:
        raise SystemError("kernel returned a result with an exception set") from interrupt

def in_a_callback():  # stopped inside what C calls back, as Numba's compiler is: ctypes reports the exception, goes on
    import ctypes, time

    @ctypes.CFUNCTYPE(None)
    def callback():
        print("ready", flush=True)
        while True:
            time.sleep(0.01)

    callback()
    while True:
        time.sleep(0.01)

run_until_stopped(%s)
"""


def start(run: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM % run], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@pytest.mark.parametrize("where", ["run", "in_a_callback"])
@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM])
def test_stopped_inside_compiled_code_it_ends_without_a_word(signum: signal.Signals, where: str) -> None:
    with start(where) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signum)
        _, said = process.communicate(timeout=20)
    assert (process.returncode, said) == (0, "")


def test_a_failure_that_nobody_asked_for_is_told() -> None:
    with start("lambda: 1 / 0") as process:
        _, said = process.communicate(timeout=20)
    assert process.returncode == 1
    assert "ZeroDivisionError" in said
