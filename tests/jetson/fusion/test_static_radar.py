"""R9 from raw chirps on: a covered lidar, nobody who measures the vehicle's motion, somebody who stops ahead."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from services.radar_pi.config import OwnSpeedConfig, RadarConfig
from services.radar_pi.emulator.signals import simulator_waveform
from services.radar_pi.pipeline import RadarPipeline
from spotter_sim.bgt60 import LEAKAGE, Target, simulate

CONFIG = RadarConfig()
SHAPE = simulator_waveform(CONFIG.waveform)
WALLS = [Target(r, 0.0, a, 500.0) for r, a in ((2.6, 0.5), (3.4, -0.5), (4.2, 0.4), (5.1, -0.3), (5.9, 0.2))]
COMES = [Target(4.0 - 0.1 * i, -1.0, 0.0, 400.0) for i in range(31)]
STANDS = [Target(1.0 + 0.004 * np.sin(1.9 * i), 0.0, 0.0, 400.0) for i in range(30)]
SETTLING = 20


@pytest.mark.parametrize("knows", [True, False])
def test_a_vehicle_that_knows_from_its_radar_that_it_stands_does_not_alarm_for_what_stands(
    new_bench: Any, knows: bool
) -> None:
    """Where the radar does not say so either, the standing track counts: it is not known to be none of ours."""
    bench = new_bench()
    bench.silent.add("radar")
    bench.extra["lidar"] = {"state": "degraded", "reason": "covered"}
    radar = RadarPipeline(msgspec.structs.replace(CONFIG, own_speed=OwnSpeedConfig(enabled=knows)))
    verdicts = []
    for number, body in enumerate([None] * SETTLING + COMES + STANDS):
        echoes = [*LEAKAGE, *WALLS] + ([body] if body else [])
        tracks = radar.process(bench.now_ns, simulate(echoes, SHAPE, seed=number))
        for key, message in (("pi0/radar/tracks", tracks), ("pi0/radar/motion", radar.motion())):
            message.seq = number
            bench.receive(key, message)
        bench.tick()
        verdicts.append(bench.tick())
    coming, standing = verdicts[SETTLING + 12 : SETTLING + len(COMES)], verdicts[-10:]
    assert {verdict.level for verdict in coming} == {"CAUTION", "IMMINENT"}
    assert tracks.static_level == "CAUTION"
    assert bench.pipeline.step.inputs.moving is (False if knows else None)
    expected = ("SAFE", "R0-clear") if knows else ("CAUTION", "R9-static-radar")
    assert {(verdict.level, verdict.rule) for verdict in standing} == {expected}
