"""Who kills the proving ground ends its workers as well."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

PROVE = [sys.executable, "-m", "spotter_tools.cli", "prove", "--only", "yard", "--jobs", "2"]


def _children(pid: int) -> list[int]:
    try:
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def _runs(pid: int) -> bool:
    stat = Path(f"/proc/{pid}/stat")
    return stat.exists() and stat.read_text().rsplit(")", 1)[1].split()[0] != "Z"


def test_workers_end_with_a_parent_that_was_killed(until):
    with subprocess.Popen(PROVE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as parent:
        until(lambda: len(_children(parent.pid)) >= 3)  # two workers and what keeps track of their semaphores
        workers = _children(parent.pid)
        parent.kill()
    until(lambda: not any(_runs(worker) for worker in workers))
