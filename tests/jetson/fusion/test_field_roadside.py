"""Field cases of the roadside, played through the pipeline: traffic that passes, traffic that hits, and ourselves."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

from common.geometry import pose_2d
from common.messages import EgoMotion, ObjectTrack
from services.jetson.fusion.config import FusionConfig, RoadsideConfig

COVARIANCE = np.diag([0.0225, 0.0225, 0.01, 0.04, 0.04, 0.01]).tolist()  # 0.15 m and 0.2 m/s
SIZES = {"bus": (12.0, 2.55, 3.1), "car": (4.5, 1.8, 1.5), "pedestrian": (0.6, 0.6, 1.7), "own": (0.5, 0.4, 0.3)}
LABELS: dict[str, Any] = {"bus": "large_vehicle", "car": "car", "pedestrian": "pedestrian", "own": "unknown"}
SITE = FusionConfig(roadside=RoadsideConfig(enabled=True))


class Body(NamedTuple):
    """What drives in the map: place and heading at a moment, and how it is seen."""

    kind: str
    at: Callable[[float], tuple[float, float, float]]  # x, y, heading after so many seconds
    track_id: int = 300_000_001


def straight(x: float, y: float, heading: float, speed: float) -> Callable[[float], tuple[float, float, float]]:
    return lambda t: (x + speed * t * math.cos(heading), y + speed * t * math.sin(heading), heading)


class Street:
    """Bodies on a bench with the roadside lidar: noisy tracks, 10 Hz, 0.12 s old; the vehicle may move as well."""

    def __init__(self, new_bench: Any, *bodies: Body, config: FusionConfig = SITE, seed: int = 1) -> None:
        self.bench = new_bench(config)
        self.bench.delay_s["infra_lidar"] = 0.12
        self.bench.run(1.0)
        self.start_s = self.bench.now_s
        self.bodies = list(bodies)
        self.noise = np.random.default_rng(seed)
        self.ego: Callable[[float], EgoMotion] | None = None

    def play(self, seconds: float) -> list[Any]:
        """The verdicts of so many seconds."""
        first = len(self.bench.verdicts)
        for _ in range(round(seconds / 0.05)):
            t_s = self.bench.now_s + 0.05 - self.start_s
            self.bench.extra["infra_lidar"] = {"tracks": [self.track(body, t_s - 0.12) for body in self.bodies]}
            if self.ego is not None:
                self.bench.receive("jetson0/ego/motion", self.ego(t_s))
            self.bench.tick()
        return list(self.bench.verdicts[first:])

    def track(self, body: Body, t_s: float) -> ObjectTrack:
        (x, y, heading), (x0, y0, _) = body.at(t_s), body.at(t_s - 0.01)
        dx, dy = self.noise.normal(0.0, 0.12, 2)
        dvx, dvy = self.noise.normal(0.0, 0.15, 2)
        return ObjectTrack(
            track_id=body.track_id, label=LABELS[body.kind], label_confidence=0.9, position_m=(x + dx, y + dy, 0.8),
            velocity_mps=((x - x0) / 0.01 + dvx, (y - y0) / 0.01 + dvy, 0.0), covariance=COVARIANCE,
            size_m=SIZES[body.kind], yaw_rad=heading + self.noise.normal(0.0, math.radians(2.0)), age_s=5.0, score=0.9,
            state="confirmed", points=200,
        )  # fmt: skip


def levels(verdicts: list[Any]) -> set[str]:
    return {verdict.level for verdict in verdicts}


def passing(kind: str, air_m: float, speed: float = 10.0) -> Body:
    """Along x on our left, with so much air between its side and our outline (0.4 m)."""
    return Body(kind, straight(-35.0, 0.4 + air_m + SIZES[kind][1] / 2, 0.0, speed))


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("speed", [4.0, 10.0, 14.0])
def test_a_bus_with_more_than_four_metres_of_air_is_no_alarm(new_bench: Any, speed: float, seed: int) -> None:
    street = Street(new_bench, passing("bus", 4.35, speed), seed=seed)
    assert levels(street.play(70.0 / speed)) == {"SAFE"}


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("speed", [3.0, 10.0, 14.0])
def test_a_car_with_nine_tenths_of_a_metre_of_air_is_not_imminent(new_bench: Any, speed: float, seed: int) -> None:
    street = Street(new_bench, passing("car", 0.9, speed), seed=seed)
    assert "IMMINENT" not in levels(street.play(70.0 / speed))


@pytest.mark.parametrize("kind", ["bus", "car", "pedestrian"])
@pytest.mark.parametrize("beside_m", [0.0, 0.3, -0.3])
def test_what_comes_straight_at_us_is_caution_then_imminent_in_time(new_bench: Any, kind: str, beside_m: float) -> None:
    """It stops short of us, so that the alarm is judged by the time before."""
    speed = 1.4 if kind == "pedestrian" else 8.0
    street = Street(new_bench, Body(kind, straight(60.0, beside_m, math.pi, speed)))
    contact_s = (60.0 - SIZES[kind][0] / 2 - 0.3) / speed
    assert levels(street.play(contact_s - 3.5)) == {"SAFE"}
    street.play(1.2)
    assert street.bench.verdict.level == "CAUTION"
    assert street.bench.verdict.rule == "I1-roadside"
    street.play(1.6)
    assert (street.bench.verdict.level, street.bench.verdict.permission) == ("IMMINENT", "STOP")


def test_a_long_vehicle_that_turns_across_us_is_seen_by_its_outline(new_bench: Any) -> None:
    """Its middle passes 4 m away, its flank hits us."""
    diagonal = Body("bus", straight(-14.0, 4.0, math.radians(-12.0), 6.0))
    assert "IMMINENT" in levels(Street(new_bench, diagonal).play(2.5))


def moving(speed: float, *, knows_speed: bool) -> Callable[[float], EgoMotion]:
    def ego(t_s: float) -> EgoMotion:
        pose = pose_2d(speed * t_s, 0.0, 0.0).tolist()
        motion = {"speed_mps": speed if knows_speed else None, "yaw_rate_radps": 0.0 if knows_speed else None}
        return EgoMotion(stamp_ns=ego.bench.now_ns + 50_000_000, T_map_vehicle=pose, **motion)  # type: ignore[attr-defined]

    return ego


@pytest.mark.parametrize("knows_speed", [True, False])
@pytest.mark.parametrize("speed", [0.0, 0.5, 1.0, 3.0])
@pytest.mark.parametrize("off_m", [(0.45, 0.0), (-0.45, 0.0), (0.0, 0.45), (0.0, -0.45), (-0.35, 0.35), (0.0, 0.0)])
def test_our_own_vehicle_seen_beside_us_is_ourselves(
    new_bench: Any, off_m: tuple[float, float], speed: float, knows_speed: bool
) -> None:
    own = Body("own", lambda t: (speed * t + off_m[0], off_m[1], 0.0))
    street = Street(new_bench, own)
    ego = moving(speed, knows_speed=knows_speed)
    ego.bench = street.bench  # type: ignore[attr-defined]
    street.ego = ego
    assert levels(street.play(12.0)) == {"SAFE"}


def test_our_own_vehicle_that_nobody_tells_the_motion_of_is_ourselves_too(new_bench: Any) -> None:
    own = Body("own", lambda _t: (-0.45, 0.0, 0.0))
    assert levels(Street(new_bench, own).play(12.0)) == {"SAFE"}


def test_with_ourselves_in_sight_somebody_else_still_alarms(new_bench: Any) -> None:
    own = Body("own", lambda _t: (-0.45, 0.0, 0.0), track_id=300_000_002)
    street = Street(new_bench, own, Body("pedestrian", straight(10.0, 0.0, math.pi, 1.4)))
    street.play(5.5)
    assert (street.bench.verdict.level, street.bench.verdict.rule) == ("IMMINENT", "I1-roadside")


def test_somebody_who_stood_beside_us_and_walks_into_us_is_not_taken_for_us(new_bench: Any) -> None:
    """Comes from 6 m away, stands for 4 s 0.5 m beside the outline, then walks on into us."""

    def walk(t: float) -> tuple[float, float, float]:
        gone_m = 1.2 * min(t, 4.0) + 0.6 * max(0.0, min(t - 8.0, 0.8))
        return (0.0, 6.0 - gone_m, -math.pi / 2)

    street = Street(new_bench, Body("pedestrian", walk))
    street.play(7.9)
    assert street.bench.verdict.inputs["infra_lidar"].level is None, "who stands is no threat by motion"
    assert any(verdict.inputs["infra_lidar"].level == "IMMINENT" for verdict in street.play(0.9))
