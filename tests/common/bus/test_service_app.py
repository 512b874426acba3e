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

run_until_stopped(%s)
"""


def start(run: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM % run], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM])
def test_stopped_inside_compiled_code_it_ends_without_a_word(signum: signal.Signals) -> None:
    with start("run") as process:
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
