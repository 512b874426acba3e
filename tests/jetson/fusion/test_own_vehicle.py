"""What comes from outside the own vehicle changes nothing; the roadside lidar may raise a verdict, never lower it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from common.messages import EgoMotion, ObjectTrack
from services.jetson.fusion.config import FusionConfig, RoadsideConfig, VehicleConfig

RANK = {"SAFE": 0, "CAUTION": 1, "IMMINENT": 2}
CONFIG = FusionConfig(vehicle=VehicleConfig(other_hosts=("jetson1", "pi1")), roadside=RoadsideConfig(enabled=True))
TOPICS = ("lidar/zones", "radar/tracks", "camera/detections", "infra_lidar/tracks", "ego/motion", "lidar/status")
KEYS = [f"{host}/{topic}" for host in ("jetson1", "pi1", "pi7") for topic in TOPICS] + [
    "pi0/lidar/zones", "jetson0/radar/tracks", "infra0/lidar/zones", "infra0/ego/motion", "pi0/ego/motion",
]  # fmt: skip
COVARIANCE = tuple(tuple(row) for row in (0.01 * np.eye(6)).tolist())
levels = st.sampled_from(["SAFE", "CAUTION", "IMMINENT"])
foreign = st.lists(st.tuples(st.integers(0, 30), st.sampled_from(KEYS), levels), max_size=40)


def say(bench: Any, messages: SimpleNamespace, key: str, level: str) -> None:
    """Another host's message of the topic's own type."""
    match key.split("/", 1)[1]:
        case "lidar/zones":
            bench.receive(key, messages.lidar(bench.now_ns, level, 0.3))
        case "radar/tracks":
            bench.receive(key, messages.radar(bench.now_ns, level))
        case "camera/detections":
            bench.receive(key, messages.camera(bench.now_ns, level))
        case "infra_lidar/tracks":
            bench.receive(key, messages.infra(bench.now_ns))
        case "ego/motion":
            bench.receive(key, EgoMotion(stamp_ns=bench.now_ns, speed_mps=9.0, yaw_rate_radps=0.0))
        case _:
            bench.status("lidar", "disconnected", "not ours")
            bench.pending[-1] = bench.pending[-1].__class__(key, bench.pending[-1].message, bench.now_s, bench.now_ns)


@settings(max_examples=60, deadline=None)
@given(foreign=foreign, own=st.lists(levels, min_size=31, max_size=31))
def test_messages_from_outside_the_vehicle_never_change_a_verdict(
    new_bench: Any, messages: SimpleNamespace, foreign: list[tuple[int, str, str]], own: list[str]
) -> None:
    alone, crowded = new_bench(CONFIG), new_bench(CONFIG)
    for step, level in enumerate(own):
        for at, key, word in foreign:
            if at == step:
                say(crowded, messages, key, word)
        for bench in (alone, crowded):
            bench.levels["lidar"] = level
            bench.tick()
    assert alone.verdicts == crowded.verdicts
    assert alone.health.sensors == crowded.health.sensors


def test_another_vehicle_is_neither_a_stranger_nor_among_the_services(
    new_bench: Any, messages: SimpleNamespace
) -> None:
    bench = new_bench(CONFIG)
    bench.instances |= {("jetson1", "lidar", "theirs"), ("pi7", "radar", "stranger")}
    for _ in range(40):
        bench.receive("jetson1/lidar/zones", messages.lidar(bench.now_ns, "IMMINENT", 0.3))
        bench.tick()
    assert not bench.pipeline.bad_input
    assert "pi7/radar" in bench.health.services
    assert not any(name.startswith("jetson1/") for name in bench.health.services)


@settings(max_examples=40, deadline=None)
@given(own=st.lists(levels, min_size=31, max_size=31), track=st.tuples(*[st.floats(-20, 20)] * 4))
def test_the_roadside_only_raises(new_bench: Any, own: list[str], track: tuple[float, float, float, float]) -> None:
    x_m, y_m, vx_mps, vy_mps = track
    seen = ObjectTrack(
        track_id=1, label="car", label_confidence=0.9, position_m=(x_m, y_m, 0.5), velocity_mps=(vx_mps, vy_mps, 0.0),
        covariance=COVARIANCE, size_m=(4.0, 1.8, 1.5), yaw_rad=0.0, age_s=2.0, score=0.9,
        state="confirmed", points=100,
    )  # fmt: skip
    without, with_roadside = new_bench(CONFIG), new_bench(CONFIG)
    with_roadside.extra["infra_lidar"] = {"tracks": [seen]}
    for level in own:
        for bench in (without, with_roadside):
            bench.levels["lidar"] = level
            bench.tick()
    pairs = zip(without.verdicts, with_roadside.verdicts, strict=True)
    assert all(RANK[more.level] >= RANK[less.level] for less, more in pairs)
