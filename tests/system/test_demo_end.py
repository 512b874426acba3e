"""The end of the demo: with nothing beside it, for it starts in half the time then."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from common.topics import SERVICES

pytestmark = [pytest.mark.system, pytest.mark.whole, pytest.mark.slow, pytest.mark.timeout(240)]


def test_ctrl_c_leaves_no_process_behind(
    tmp_path: Path, free_ports: Callable[[], int], until: Callable[..., None]
) -> None:
    port, endpoint = free_ports(), f"tcp/127.0.0.1:{free_ports()}"
    spotter = str(Path(sys.executable).with_name("spotter"))
    log = tmp_path / "log"
    command = [spotter, "demo", "--listen", endpoint, "--port", str(port)]
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, start_new_session=True)
    root = psutil.Process(process.pid)

    def is_up() -> bool:
        assert process.poll() is None, log.read_text()
        return "Spotter is up" in log.read_text()

    until(is_up, budget_s=100)
    family = root.children(recursive=True)
    assert len(family) >= len(SERVICES) + 1
    process.send_signal(signal.SIGINT)
    assert process.wait(15) == 0
    _, left = psutil.wait_procs(family, timeout=2)
    assert not left
    assert not [c for c in psutil.net_connections("tcp") if c.laddr and c.laddr.port == port and c.status == "LISTEN"]
