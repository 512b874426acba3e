"""The vocabulary of the simulated world: actors, the state of the world at one moment, scenarios."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np

from common.geometry import pose_2d
from spotter_sim.bodies import DEFAULT_SIZE_M, body
from spotter_sim.motion import Motion, Standing
from spotter_sim.scene import Scene
from spotter_sim.solids import PARTS, Solids, join
from spotter_sim.vehicle import MODEL_CAR, STANDING, Chassis, VehicleState, driven

FAULTS = (
    "lidar_blocked",
    "lidar_unplugged",
    "camera_dark",
    "camera_unplugged",
    "radar_silent",
    "radar_unplugged",
)


@dataclass(frozen=True)
class Weather:
    """Weather effects on lidar and camera; no effect on radar."""

    light: float = 1.0  # exposure of the picture, 1 = day
    rain: float = 0.0  # 0 dry to 1 heavy: returns lost, drops seen, ranges less exact


_LIMB_STEP_S = 1e-3  # over which the velocity of legs, arms and cranks is taken


class DeviceUnplugged(OSError):
    """The simulated device is not there: what a driver reports when the plug is pulled."""


@dataclass(frozen=True, eq=False)
class Actor:
    """One person or vehicle; the box stands on its foot, map frame."""

    actor_id: int
    kind: str  # pedestrian, cyclist, car, bus, truck
    position_m: np.ndarray  # (3,) centre of the box's foot
    yaw_rad: float
    size_m: tuple[float, float, float]  # length, width, height
    velocity_mps: np.ndarray  # (3,)
    travelled_m: float = 0.0
    material: str = ""  # of all parts, when it is not what such a body is made of; one of PARTS

    @property
    def T_map_body(self) -> np.ndarray:
        """(4, 4) pose of the foot of the box in the map."""
        return pose_2d(self.position_m[0], self.position_m[1], self.yaw_rad, self.position_m[2])

    @property
    def reach_m(self) -> float:
        """No part of the body is farther from its foot in the plane (a swung arm included)."""
        return 0.5 * math.hypot(self.size_m[0], self.size_m[1]) + 0.3

    @cached_property
    def solids(self) -> Solids:
        """The body in the map frame, as every sensor sees it; all parts with the actor's velocity."""
        return self._body(self.travelled_m).placed(self.T_map_body, self.actor_id, self.velocity_mps)

    @cached_property
    def swinging_solids(self) -> Solids:
        """The same with the velocity of every limb of its own: for the radar, which sees speeds."""
        way_m = float(np.linalg.norm(self.velocity_mps)) * _LIMB_STEP_S
        way = self._body(self.travelled_m + way_m).centre_m - self._body(self.travelled_m).centre_m
        limbs_mps = way @ self.T_map_body[:3, :3].T / _LIMB_STEP_S
        return replace(self.solids, velocity_mps=self.velocity_mps + limbs_mps)

    def _body(self, travelled_m: float) -> Solids:
        solids = body(self.kind, self.size_m, travelled_m, float(np.linalg.norm(self.velocity_mps)))
        if not self.material:
            return solids
        return replace(solids, part=np.full(len(solids), PARTS.index(self.material), np.uint8))


@dataclass(frozen=True, eq=False)
class WorldState:
    """Everything that is true at one moment."""

    scenario: str
    t_s: float
    actors: tuple[Actor, ...]
    T_map_vehicle: np.ndarray  # (4, 4)
    vehicle_speed_mps: float
    vehicle_yaw_rate_radps: float
    faults: frozenset[str]
    scene: Scene
    vehicle: VehicleState = STANDING  # all about its motion; the three fields above say the same in short
    chassis: Chassis = MODEL_CAR
    weather: Weather = Weather()
    drives: bool = False  # the vehicle has a motion of its own, though it may stand at this moment

    @cached_property
    def solids(self) -> Solids:
        """Fixtures and all bodies, map frame."""
        return join([self.scene.fixtures, *(actor.solids for actor in self.actors)])

    def solids_near(self, point_m: np.ndarray, within_m: float, limbs: bool = False) -> Solids:
        """Those that may have a part within ``within_m`` of a point, map frame; bodies far away are not even built.

        With ``limbs``, arms and legs carry their own velocity.
        """
        close = [a for a in self.actors if math.dist(a.position_m[:2], point_m[:2]) < within_m + a.reach_m]
        bodies = [actor.swinging_solids if limbs else actor.solids for actor in close]
        x, y, z = point_m.tolist()
        return join([fixtures_near(self.scene, (x, y, z), within_m), *bodies])


@lru_cache(maxsize=64)
def fixtures_near(scene: Scene, point_m: tuple[float, float, float], within_m: float) -> Solids:
    """The fixtures near a place where a sensor stands; kept, because they stand still."""
    return scene.fixtures.near(np.array(point_m), within_m)


@dataclass(frozen=True)
class Player:
    """An actor and the way it moves."""

    actor_id: int
    kind: str
    motion: Motion
    size_m: tuple[float, float, float] | None = None
    material: str = ""

    def at(self, t_s: float, scene: Scene) -> Actor:
        """Where it is at scenario time ``t_s``, standing on the scene's ground."""
        return _standing(self, scene) if isinstance(self.motion, Standing) else self.placed(t_s, scene)

    def placed(self, t_s: float, scene: Scene) -> Actor:
        """The same, worked out anew."""
        pose = self.motion.at(t_s)
        along_x, along_y = scene.ground.gradient(pose.x_m, pose.y_m)
        climb = along_x * pose.vx_mps + along_y * pose.vy_mps
        z = float(scene.ground.height(pose.x_m, pose.y_m))
        return Actor(
            self.actor_id,
            self.kind,
            np.array([pose.x_m, pose.y_m, z]),
            pose.yaw_rad,
            self.size_m or DEFAULT_SIZE_M[self.kind],
            np.array([pose.vx_mps, pose.vy_mps, climb]),
            pose.travelled_m,
            self.material,
        )


@lru_cache(maxsize=1024)
def _standing(player: Player, scene: Scene) -> Actor:
    """What never moves is placed once; its body is kept with it."""
    return player.placed(0.0, scene)


@dataclass(frozen=True)
class Fault:
    """A fault that is there from ``start_s`` until ``end_s`` of the scenario."""

    name: str
    start_s: float
    end_s: float


@dataclass(frozen=True, eq=False)
class Scenario:
    """A world that repeats itself every ``length_s``; without a ``vehicle`` ours stands at the map's origin."""

    name: str
    length_s: float
    scene: Scene
    cast: tuple[Player, ...] = ()
    faults: tuple[Fault, ...] = field(default=())
    vehicle: Motion | None = None
    chassis: Chassis = MODEL_CAR
    weather: Weather = Weather()

    def at(self, t_s: float) -> WorldState:
        """The state at any time; beyond the length it repeats. A pure function of the time."""
        return _state(self, t_s % self.length_s)


@lru_cache(maxsize=64)
def _state(scenario: Scenario, t_s: float) -> WorldState:
    vehicle = STANDING
    if scenario.vehicle is not None:
        vehicle = driven(scenario.vehicle, t_s, scenario.scene.ground, scenario.chassis)
    return WorldState(
        scenario=scenario.name,
        t_s=t_s,
        actors=tuple(player.at(t_s, scenario.scene) for player in scenario.cast),
        T_map_vehicle=vehicle.T_map_vehicle,
        vehicle_speed_mps=vehicle.speed_mps,
        vehicle_yaw_rate_radps=vehicle.yaw_rate_radps,
        faults=frozenset(f.name for f in scenario.faults if f.start_s <= t_s < f.end_s),
        scene=scenario.scene,
        vehicle=vehicle,
        chassis=scenario.chassis,
        weather=scenario.weather,
        drives=scenario.vehicle is not None,
    )


def noise_rng(name: str, t_s: float, what: str) -> np.random.Generator:
    """A generator that depends on the scenario, the time (to the microsecond) and the sensor only."""
    key = [*f"{name}/{what}".encode(), math.floor(t_s * 1e6 + 0.5)]
    return np.random.Generator(np.random.SFC64(key))
