"""What every sensor ought to say at a moment: exact, without noise, persistence or delay.

The levels follow the rules of the system (lidar bands 0.8 / 1.8 m in the vehicle's corridor, radar 0.5 / 1.2 m or
1.5 / 3 s to collision for what closes in, camera 0.5 / 1.2 m in the middle of the picture). A real service may lag by
its persistence (about 0.4 s) and disagree within the measurement errors at a limit.

For a vehicle that drives, those levels are what the article's rules say; what is true is ``contact_s``: when the
vehicle's outline will touch something if all go on as they do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.geometry import invert, transform_points
from common.messages import Level, SensorState, worst
from spotter_sim.bgt60 import facing_point
from spotter_sim.camera import TrueBox, boxes
from spotter_sim.contact import contact_s
from spotter_sim.ld06 import slice_ranges
from spotter_sim.model import Actor, Scenario, WorldState
from spotter_sim.view import SIZE_PX
from spotter_sim.world import world_at

LIDAR_BANDS_M = (0.8, 1.8)
NEAR_BANDS_M = (0.5, 1.2)  # radar and camera
TTC_BANDS_S = (1.5, 3.0)
LOOK_AHEAD_M, FLOOR_M = 3.0, 0.2
CONE_RAD = np.radians(20.0)
STRIP_M = 0.025  # beside the vehicle's own width, left and right
RADAR_VIEW_RAD, RADAR_RANGE_M = np.radians(45.0), 6.0
STATIC_MPS = 0.15
HORIZON_S = 4.0
CAMERA_ZONE = 0.4  # share of the picture's width in the middle
_RAY_STEP_RAD = np.radians(0.05)


@dataclass(frozen=True)
class ZoneTruth:
    """Distance along x to the nearest surface in each strip of the corridor; None when it is free."""

    left_m: float | None
    centre_m: float | None
    right_m: float | None

    @property
    def nearest_m(self) -> float | None:
        """The least of the three, None when all are empty."""
        return min((d for d in (self.left_m, self.centre_m, self.right_m) if d is not None), default=None)


@dataclass(frozen=True)
class RadarTruth:
    """One moving actor in the radar's view; range to its nearest point, closing is negative."""

    actor_id: int
    range_m: float
    azimuth_rad: float
    velocity_mps: float
    level: Level


@dataclass(frozen=True)
class Truth:
    """Levels and zones are None, targets empty for a sensor that cannot see."""

    t_s: float
    lidar_state: SensorState
    radar_state: SensorState
    camera_state: SensorState
    lidar_level: Level | None
    radar_level: Level | None
    camera_level: Level | None  # None as well when nothing is in the zone
    verdict: Level  # after the decision rules, without the timed suppression
    zones: ZoneTruth | None
    radar_targets: tuple[RadarTruth, ...]
    contact_s: float | None = None  # of a vehicle that drives; None = not within ``HORIZON_S``, or it has no motion


def expect(name: str | Scenario, t_s: float) -> Truth:
    """The truth of a scenario at a time."""
    world = world_at(name, t_s)
    lidar, radar, camera = states(world.faults)
    zones = lidar_zones(world) if lidar == "online" else None
    targets = radar_targets(world) if radar == "online" else ()
    seen = tuple(boxes(name, t_s)) if camera == "online" else ()
    lidar_level = band(zones.nearest_m, LIDAR_BANDS_M) if zones else None
    radar_level = worst(*(target.level for target in targets)) if radar == "online" else None
    camera_level = _camera_level(seen)
    verdict = decide(lidar_level, radar_level, camera_level, (lidar, radar, camera))
    contact = contact_s(world, HORIZON_S) if world.drives else None
    return Truth(
        world.t_s, lidar, radar, camera, lidar_level, radar_level, camera_level, verdict, zones, targets, contact
    )  # fmt: skip


def states(faults: frozenset[str]) -> tuple[SensorState, SensorState, SensorState]:
    """(lidar, radar, camera) as health ought to show them once a fault has lasted."""
    lidar: SensorState = "degraded" if "lidar_blocked" in faults else "online"
    camera: SensorState = "degraded" if "camera_dark" in faults else "online"
    return (
        "disconnected" if "lidar_unplugged" in faults else lidar,
        "disconnected" if faults & {"radar_silent", "radar_unplugged"} else "online",
        "disconnected" if "camera_unplugged" in faults else camera,
    )


def band(distance_m: float | None, limits_m: tuple[float, float]) -> Level:
    """IMMINENT up to the first limit, CAUTION up to the second, else (or with nothing there) SAFE."""
    if distance_m is None or distance_m > limits_m[1]:
        return "SAFE"
    return "IMMINENT" if distance_m <= limits_m[0] else "CAUTION"


def lidar_zones(world: WorldState) -> ZoneTruth:
    """The corridor as the lidar's plane cuts it, by rays every 0.05 degree."""
    angle = np.arange(-CONE_RAD, CONE_RAD + _RAY_STEP_RAD / 2, _RAY_STEP_RAD)
    range_m, _ = slice_ranges(world, angle)
    inside = np.isfinite(range_m) & (range_m >= FLOOR_M)
    range_m = np.where(inside, range_m, 0.0)
    x, y = range_m * np.cos(angle), range_m * np.sin(angle)
    ahead = inside & (x <= LOOK_AHEAD_M)
    half = 0.5 * world.chassis.size_m[1]
    return ZoneTruth(
        left_m=_nearest(x, ahead & (y > half) & (y <= half + STRIP_M)),
        centre_m=_nearest(x, ahead & (np.abs(y) <= half)),
        right_m=_nearest(x, ahead & (y < -half) & (y >= -half - STRIP_M)),
    )


def _nearest(x_m: np.ndarray, where: np.ndarray) -> float | None:
    return float(x_m[where].min()) if where.any() else None


def radar_targets(world: WorldState) -> tuple[RadarTruth, ...]:
    """Actors that move relative to the radar and are in its view, the nearest first."""
    found = [target for actor in world.actors if (target := _radar_target(world, actor)) is not None]
    return tuple(sorted(found, key=lambda target: target.range_m))


def _radar_target(world: WorldState, actor: Actor) -> RadarTruth | None:
    T_map_radar = world.T_map_vehicle @ world.chassis.T_vehicle_radar
    origin = T_map_radar[:3, 3]
    if np.linalg.norm(actor.position_m - origin) > RADAR_RANGE_M + 8.0:
        return None
    points = transform_points(invert(T_map_radar), facing_point(actor.solids, origin))
    ranges = np.linalg.norm(points, axis=1)
    nearest = points[ranges.argmin()]
    middle = transform_points(invert(T_map_radar), actor.position_m)
    azimuth = float(np.arctan2(middle[1], middle[0]))
    own = nearest * [1.0, 1.0, 0.0]  # the line of sight in the plane: bodies move in the plane
    relative_mps = actor.velocity_mps - world.vehicle.velocity_of(world.chassis.T_vehicle_radar)
    velocity = float(relative_mps @ T_map_radar[:3, :3] @ own / np.linalg.norm(own))
    range_m = float(ranges.min())
    if range_m > RADAR_RANGE_M or abs(azimuth) > RADAR_VIEW_RAD or abs(velocity) < STATIC_MPS:
        return None
    return RadarTruth(actor.actor_id, range_m, azimuth, velocity, _closing_level(range_m, velocity))


def _closing_level(range_m: float, velocity_mps: float) -> Level:
    """Only what closes in alarms, by time to collision or by range."""
    if velocity_mps > -STATIC_MPS:
        return "SAFE"
    return worst(band(range_m / -velocity_mps, TTC_BANDS_S), band(range_m, NEAR_BANDS_M))


def _camera_level(seen: tuple[TrueBox, ...]) -> Level | None:
    """The worst band of what stands in the middle of the picture and is mostly visible; None = nothing there."""
    margin = 0.5 * (1.0 - CAMERA_ZONE) * SIZE_PX[0]
    levels = [
        band(box.distance_m, NEAR_BANDS_M)
        for box in seen
        if box.visible >= 0.5 and margin <= 0.5 * (box.box_xyxy_px[0] + box.box_xyxy_px[2]) <= SIZE_PX[0] - margin
    ]
    return worst(*levels) if levels else None


def decide(
    lidar: Level | None, radar: Level | None, camera: Level | None, state: tuple[SensorState, SensorState, SensorState]
) -> Level:
    """The decision procedure: worst of lidar and radar; the camera confirms, or stands in for the lidar."""
    verdict = worst(*(level for level in (lidar, radar) if level is not None))
    if camera is not None:
        if state[0] != "online":
            verdict = worst(verdict, "CAUTION", camera)
        elif verdict != "SAFE":
            verdict = worst(verdict, camera)
    if sum(s != "online" for s in state) >= 2:
        verdict = worst(verdict, "CAUTION")
    return verdict
