"""A verdict is live only when everything that was weighed is live; the health says of every sensor what it is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from common.messages import SOURCE_KINDS, EgoMotion, SourceKind
from services.jetson.fusion.config import FusionConfig, VehicleConfig
from services.jetson.fusion.evidence import FusionInputs, FusionMemory, SensorInput
from services.jetson.fusion.verdict import fuse

SEES = SensorInput(state="online", level="SAFE", age_s=0.02, source_kind="live")
LIVE = FusionInputs(now_s=10.0, moving=False, lidar=SEES, radar=SEES, camera=replace(SEES, level=None))


def kind_of(inputs: FusionInputs, memory: FusionMemory | None = None) -> SourceKind:
    return fuse(inputs, memory or FusionMemory())[0].source_kind


def test_three_live_sensors_give_a_live_verdict() -> None:
    assert kind_of(LIVE) == "live"
    assert fuse(LIVE, FusionMemory())[0].inputs["radar"].source_kind == "live"


@pytest.mark.parametrize("name", ["lidar", "radar", "camera", "roadside", "gap"])
@pytest.mark.parametrize("kind", SOURCE_KINDS)
def test_one_sensor_that_is_not_live_marks_the_verdict(name: str, kind: SourceKind) -> None:
    one = replace(SEES, source_kind=kind)
    inputs = replace(LIVE, others={"gap": one}) if name == "gap" else replace(LIVE, **{name: one})
    assert kind_of(inputs) == kind


@pytest.mark.parametrize("kind", SOURCE_KINDS)
def test_the_vehicles_motion_counts(kind: SourceKind) -> None:
    assert kind_of(replace(LIVE, motion_kind=kind)) == kind


def test_a_sensor_that_is_out_does_not_mark_it() -> None:
    gone = SensorInput(state="disconnected", level=None, source_kind="simulated")
    assert kind_of(replace(LIVE, radar=gone)) == "live"


def test_an_alarm_that_is_held_for_a_simulated_sensor_marks_it() -> None:
    near = replace(SEES, level="IMMINENT", source_kind="simulated")
    verdict, memory = fuse(replace(LIVE, radar=near), FusionMemory())
    gone = SensorInput(state="disconnected", level=None, source_kind="simulated")
    held, _ = fuse(replace(LIVE, radar=gone, now_s=10.1), memory)
    assert (verdict.source_kind, held.level, held.source_kind) == ("simulated", "IMMINENT", "simulated")


def test_without_any_sensor_nothing_is_claimed() -> None:
    gone = SensorInput(state="disconnected", level=None)
    assert kind_of(replace(LIVE, lidar=gone, radar=gone, camera=gone)) == "unknown"


def test_health_tells_each_sensors_kind(bench: Any) -> None:
    for name in bench.extra:
        bench.extra[name] = {"source_kind": "live"}
    bench.run(1.0)
    assert (bench.verdict.source_kind, bench.health.source_kind) == ("live", "live")
    bench.extra["camera"] = {"source_kind": "recorded"}
    bench.run(1.0)
    assert [bench.sensor(name).source_kind for name in ("lidar", "camera")] == ["live", "recorded"]
    assert (bench.verdict.source_kind, bench.health.source_kind) == ("recorded", "recorded")


def test_a_sensor_that_turns_to_simulation_is_told_at_once(bench: Any) -> None:
    """The health message comes with the change, not with the next period."""
    for name in bench.extra:
        bench.extra[name] = {"source_kind": "live"}
    bench.run(1.0)
    bench.extra["lidar"] = {"source_kind": "simulated"}
    bench.until(lambda: bench.sensor("lidar").source_kind == "simulated", 0.1)


def live_bench(new_bench: Any) -> Any:
    """A fusion of a live site, with three live sensors that are online."""
    bench = new_bench(FusionConfig(vehicle=VehicleConfig(live_only=True)))
    for name in bench.extra:
        bench.extra[name] = {"source_kind": "live"}
    bench.run(1.0)
    assert (bench.health.colour, bench.verdict.level, bench.verdict.source_kind) == ("green", "SAFE", "live")
    return bench


@pytest.mark.parametrize("kind", [kind for kind in SOURCE_KINDS if kind != "live"])
def test_a_live_site_takes_no_other_data(new_bench: Any, messages: Any, kind: SourceKind) -> None:
    """A demo's lidar speaks under the live lidar's key: it is counted, and the verdict does not move."""
    bench = live_bench(new_bench)
    for _ in range(20):
        bench.receive(bench.key("lidar"), messages.lidar(bench.now_ns, "IMMINENT", 0.3, source_kind=kind))
        assert (bench.tick().level, bench.verdict.source_kind) == ("SAFE", "live")
    assert bench.is_in("lidar", "online")
    assert bench.pipeline.bad_input[f"{bench.key('lidar')}: {kind}, and this site is live"] == 20


def test_a_live_site_whose_lidar_is_simulated_has_no_lidar(new_bench: Any) -> None:
    bench = new_bench(FusionConfig(vehicle=VehicleConfig(live_only=True)))
    for name in bench.extra:
        bench.extra[name] = {"source_kind": "simulated" if name == "lidar" else "live"}
    verdict = bench.run(2.0)
    assert bench.is_in("lidar", "disconnected", "waiting")
    assert bench.sensor("lidar").reason == "its data is simulated, and this site is live"
    assert verdict.level == "CAUTION"


def test_a_live_site_takes_no_simulated_motion(new_bench: Any) -> None:
    bench = live_bench(new_bench)
    motion = EgoMotion(stamp_ns=bench.now_ns, speed_mps=0.0, yaw_rate_radps=0.0, source_kind="simulated")
    bench.receive("jetson0/ego/motion", motion)
    assert bench.tick().source_kind == "live"
    assert bench.pipeline.step.inputs.moving is None
