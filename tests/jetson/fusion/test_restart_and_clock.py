"""Fusion is restarted while somebody sets the clock: what it remembered is as old as the monotonic clock says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from services.jetson.fusion.evidence import Claim, FusionMemory
from services.jetson.fusion.observation import Observation
from services.jetson.fusion.pipeline import FusionPipeline
from services.jetson.fusion.store import Saved, Store, resumed

HOUR_NS = 3600 * 10**9


def restart(bench: Any, folder: Path, clock_step_s: float) -> None:
    """Half a second passes between the two processes, and UTC is set by so much."""
    store = Store(str(folder), "spotter", "jetson0")
    store.write(bench.pipeline.state(Observation(now_s=bench.now_s, now_ns=bench.now_ns)))
    bench.pipeline = FusionPipeline(bench.config, store.load())
    bench.now_s = round(bench.now_s + 0.5, 6)
    bench.our_clock_s += clock_step_s


@pytest.mark.parametrize("clock_step_s", [0.0, 3600.0, -3600.0])
def test_a_restart_and_a_clock_that_is_set_lower_no_alarm(bench: Any, tmp_path: Path, clock_step_s: float) -> None:
    """Standing, the lidar dead: IMMINENT for ten seconds, of which one and a half have passed."""
    bench.levels["lidar"] = "IMMINENT"
    bench.drive(0.0, 0.0, 1.0)
    bench.kill("lidar")
    bench.drive(0.0, 0.0, 1.0)
    restart(bench, tmp_path, clock_step_s)
    first = len(bench.verdicts)
    bench.drive(0.0, 0.0, 8.0)
    assert {verdict.level for verdict in bench.verdicts[first:]} == {"IMMINENT"}
    bench.drive(0.0, 0.0, 1.0)
    assert bench.verdict.level == "CAUTION"


@pytest.mark.parametrize("clock_step_s", [0.0, 3600.0, -3600.0])
def test_a_clock_that_is_set_makes_no_start_up_of_a_restart(bench: Any, tmp_path: Path, clock_step_s: float) -> None:
    bench.run(15.0)
    bench.kill("camera")
    bench.run(1.0)
    restart(bench, tmp_path, clock_step_s)
    first = len(bench.verdicts)
    bench.run(3.0)
    assert "A25-starting" not in {verdict.rule for verdict in bench.verdicts[first:]}


def test_after_a_start_of_the_machine_utc_tells_how_old_the_memory_is(tmp_path: Path) -> None:
    claim = Claim("lidar", "IMMINENT", 1000.0, 1000.0)
    store = Store(str(tmp_path), "spotter", "jetson0")
    store.write(Saved(HOUR_NS, 1000.0, 0.0, FusionMemory(1000.0, (claim,))))
    (file,) = tmp_path.iterdir()
    file.write_bytes(msgspec.json.encode({**msgspec.json.decode(file.read_bytes()), "boot": "another"}))
    saved = store.load()
    assert saved is not None
    assert resumed(saved, 50.0, HOUR_NS + 20 * 10**9).memory.claims[0].seen_s == 30.0
