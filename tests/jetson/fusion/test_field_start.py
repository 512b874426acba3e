"""Cases from the field: start-up ends, a restart changes nothing, what is not fitted is not missed."""

from __future__ import annotations

from typing import Any

import pytest

from common.topics import ONBOARD_SENSORS
from services.jetson.fusion.config import FusionConfig, HealthConfig, SensorConfig, SensorsConfig

WITHOUT_CAMERA = tuple(name for name in ONBOARD_SENSORS if name != "camera")


def outcome(verdict: Any) -> tuple[str, str]:
    return verdict.level, verdict.permission


def test_start_up_waits_ten_seconds_at_most(new_bench: Any) -> None:
    bench = new_bench(sensors=(*WITHOUT_CAMERA, "infra_lidar"))
    bench.run(9.9)
    assert outcome(bench.verdict) == ("CAUTION", "STOP")
    assert bench.verdict.rule == "A25-starting"
    bench.run(0.2)
    assert (bench.verdict.level, bench.verdict.permission, bench.health.colour) == ("SAFE", "GO", "amber")


def test_the_time_it_waits_is_a_setting(new_bench: Any) -> None:
    bench = new_bench(FusionConfig(health=HealthConfig(start_s=2.0)), sensors=WITHOUT_CAMERA)
    assert bench.run(1.9).rule == "A25-starting"
    assert bench.run(0.2).rule == "R0-clear"


def test_the_same_world_gives_the_same_verdict_after_a_restart(bench: Any) -> None:
    """Camera frozen: SAFE / GO, amber. Fusion is restarted, and waits for no camera."""
    bench.run(15.0)
    bench.silent.add("camera")
    assert outcome(bench.run(3.0)) == ("SAFE", "GO")
    bench.restart_fusion()
    bench.until(lambda: outcome(bench.verdict) == ("SAFE", "GO"), 2.0)
    assert bench.health.colour == "amber"


@pytest.mark.parametrize("missing", ONBOARD_SENSORS)
def test_nobody_misses_a_sensor_that_is_not_fitted(new_bench: Any, missing: str) -> None:
    places = {name: getattr(FusionConfig().sensors, name) for name in ONBOARD_SENSORS}
    places[missing] = SensorConfig(host=places[missing].host, expected=False)
    fitted = [name for name in ONBOARD_SENSORS if name != missing]
    bench = new_bench(FusionConfig(sensors=SensorsConfig(**places)), sensors=(*fitted, "infra_lidar"))
    verdict = bench.run(1.0)
    assert (verdict.level, verdict.permission, verdict.rule) == ("SAFE", "GO", "R0-clear")
    assert (bench.health.colour, bench.health.summary) == ("green", "ALL VEHICLE SENSORS ONLINE")
    assert missing not in verdict.inputs
    assert missing not in bench.health.sensors
    bench.kill(fitted[0])
    bench.run(1.0)
    assert (bench.health.colour, bench.verdict.level) == ("amber", "SAFE")
    for name in fitted[1:]:
        bench.kill(name)
    assert bench.run(1.0).blind
    assert outcome(bench.verdict) == ("CAUTION", "STOP")
