"""What stands still: the ground, walls, trees, poles and bushes, and the pole with the 128-beam lidar."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.geometry import rotation_between, rotation_rpy, transform
from spotter_sim.solids import CYLINDER, FOLIAGE, Solids, box, join, limbs, solid


@dataclass(frozen=True)
class Ground:
    """z = x_slope x + y_slope y + (x_bend x^2 + y_bend y^2) / 2, map metres: a slope and a camber in closed form."""

    x_slope: float = 0.0
    y_slope: float = 0.0
    x_bend_per_m: float = 0.0
    y_bend_per_m: float = 0.0

    def height(self, x_m: np.ndarray | float, y_m: np.ndarray | float) -> np.ndarray | float:
        """z in map metres."""
        bend = 0.5 * (self.x_bend_per_m * x_m * x_m + self.y_bend_per_m * y_m * y_m)
        return self.x_slope * x_m + self.y_slope * y_m + bend

    def gradient(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Rise per metre along x and along y at a place."""
        return self.x_slope + self.x_bend_per_m * x_m, self.y_slope + self.y_bend_per_m * y_m

    def normal(self, x_m: float, y_m: float) -> np.ndarray:
        """(3,) unit normal at a place, upwards, map frame."""
        along_x, along_y = self.gradient(x_m, y_m)
        n = np.array([-along_x, -along_y, 1.0])
        return n / np.linalg.norm(n)

    @property
    def patches(self) -> np.ndarray:
        """(M, 7) rectangles whose highest is the ground, over the slope and bend; see ``street_ground.Patch``."""
        return _EVERYWHERE

    def road_plane(self, x_m: float, y_m: float) -> tuple[np.ndarray, np.ndarray]:
        """(point, unit normal) of the road nearest to a place: what a calibration there has to find."""
        return np.array([x_m, y_m, float(self.height(x_m, y_m))]), self.normal(x_m, y_m)


_EVERYWHERE = np.array([[-np.inf, np.inf, -np.inf, np.inf, 0.0, 0.0, 0.0]])


@dataclass(frozen=True)
class Mount:
    """How the 128-beam lidar hangs on its pole.

    ``yaw`` is the direction it faces in the map, ``pitch`` how far it looks down, ``roll`` about the line of sight.
    """

    x_m: float
    y_m: float
    height_m: float = 5.5
    yaw_rad: float = 0.0
    pitch_rad: float = np.radians(13.5)
    roll_rad: float = np.radians(1.2)


@dataclass(frozen=True, eq=False)
class Scene:
    """A place: its ground, its fixtures and the pole."""

    ground: Ground
    fixtures: Solids
    mount: Mount

    @property
    def T_map_pole(self) -> np.ndarray:
        """(4, 4) from the sensor's own tilted frame into the map."""
        m = self.mount
        z = float(self.ground.height(m.x_m, m.y_m)) + m.height_m
        return transform(rotation_rpy(m.roll_rad, m.pitch_rad, m.yaw_rad), np.array([m.x_m, m.y_m, z]))

    @property
    def road_normal_sensor(self) -> np.ndarray:
        """(3,) true road normal at the foot of the pole, in the sensor's frame: what a calibration has to find."""
        return np.asarray(self.T_map_pole[:3, :3].T @ self.ground.road_plane(self.mount.x_m, self.mount.y_m)[1])

    @property
    def sensor_height_m(self) -> float:
        """Distance of the sensor from the road's plane at the foot of the pole."""
        point, normal = self.ground.road_plane(self.mount.x_m, self.mount.y_m)
        return float(normal @ (self.T_map_pole[:3, 3] - point))

    @property
    def T_level_sensor(self) -> np.ndarray:
        """(4, 4) truth of the levelling: shortest rotation of the road normal to z, road plane at z = 0."""
        rotation = rotation_between(self.road_normal_sensor, np.array([0.0, 0.0, 1.0]))
        return transform(rotation, np.array([0.0, 0.0, self.sensor_height_m]))


def wall(x_m: tuple[float, float], y_m: tuple[float, float], height_m: float) -> Solids:
    """An upright wall between two corners; it reaches 0.5 m into the ground, so that slopes leave no gap."""
    return box(x_m, y_m, (-0.5, height_m), "wall", "concrete")


def post(x_m: float, y_m: float, z_m: float, height_m: float, radius_m: float = 0.06) -> Solids:
    """A lamp post, sign post or bollard."""
    half = (radius_m, radius_m, 0.5 * height_m)
    return solid(CYLINDER, (x_m, y_m, z_m + 0.5 * height_m), half, "pole", "metal")


def tree(x_m: float, y_m: float, z_m: float, height_m: float, rng: np.random.Generator) -> Solids:
    """A trunk and four blobs of leaves that let some rays through."""
    crown = 0.28 * height_m
    trunk = limbs([[x_m, y_m, z_m - 0.2]], [[x_m, y_m, z_m + 0.6 * height_m]], [0.14], "tree", ["wood"])
    blobs = [trunk]
    for _ in range(4):
        dx, dy, dz = rng.uniform(-0.6, 0.6, 3) * crown
        centre = (x_m + dx, y_m + dy, z_m + 0.70 * height_m + dz)
        half = tuple(crown * rng.uniform(0.6, 1.0, 3))
        blobs.append(solid(FOLIAGE, centre, (half[0], half[1], half[2]), "tree", "leaves"))
    return join(blobs)


def bush(x_m: float, y_m: float, z_m: float, size_m: float, rng: np.random.Generator) -> Solids:
    """Two low blobs of leaves."""
    blobs = []
    for _ in range(2):
        dx, dy = rng.uniform(-0.5, 0.5, 2) * size_m
        half = size_m * rng.uniform(0.5, 0.8, 3)
        centre = (x_m + dx, y_m + dy, z_m + 0.7 * half[2])
        blobs.append(solid(FOLIAGE, centre, (half[0], half[1], half[2]), "bush", "leaves"))
    return join(blobs)


def facade(
    start_m: tuple[float, float], end_m: tuple[float, float], height_m: float, rng: np.random.Generator
) -> Solids:
    """A house front along a line, in bays of about 5 m, each set forward or back a little, with recessed windows."""
    a, b = np.array(start_m), np.array(end_m)
    length = float(np.linalg.norm(b - a))
    along = (b - a) / length
    across = np.array([-along[1], along[0]])
    rotation = np.column_stack([[*along, 0.0], [*across, 0.0], [0.0, 0.0, 1.0]])
    count = max(1, round(length / 5.0))
    bays = []
    for i in range(count):
        middle = a + along * length * (i + 0.5) / count + across * rng.uniform(-0.15, 0.15)
        half = (0.5 * length / count, 0.4, 0.5 * height_m + 0.5)
        bays.append(_block(middle, half[2] - 1.0, half, rotation, "concrete"))
        for storey in range(int(height_m // 3)):  # glass stands 3 cm proud: windows and shop fronts
            glass = (0.3 * length / count, 0.43, 0.6)
            bays.append(_block(middle, 1.7 + 3.0 * storey, glass, rotation, "glass"))
    return join(bays)


def _block(xy: np.ndarray, z: float, half: tuple[float, float, float], rotation: np.ndarray, part: str) -> Solids:
    unit = box((-1, 1), (-1, 1), (-1, 1), "wall", part)
    return Solids(
        unit.shape,
        np.array([[xy[0], xy[1], z]]),
        (rotation * np.asarray(half))[None],
        unit.kind,
        unit.part,
        unit.owner,
        unit.velocity_mps,
    )
