"""Shared by the tests of the roadside lidar: generated scenes with their truth, and recordings where they exist."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from common.geometry import rotation_between, rotation_rpy, transform
from spotter_sim import lidar128, roadside, world

RECORDINGS = Path(os.environ.get("SPOTTER_DATA", Path(__file__).parents[2].parent / "shared" / "data"))


@dataclass(frozen=True)
class SceneFrame:
    """One generated turn: points (N, 5), actor of each point (-1 scene, -2 ground), its kind, and the true level."""

    points: np.ndarray
    actor: np.ndarray
    kind: np.ndarray
    T_level_sensor: np.ndarray


@lru_cache(maxsize=40)
def _scene_frame(kind: str, seed: int, objects: int, t_s: float, columns: int) -> SceneFrame:
    scenario = roadside.roadside(seed, objects, kind)
    scan, place = lidar128.scan(scenario, t_s, columns), world.world_at(scenario, t_s).scene
    slope = np.array([-place.ground.x_slope, -place.ground.y_slope, 1.0])
    slope /= np.linalg.norm(slope)
    T = place.T_map_pole
    foot = np.array([0.0, 0.0, place.ground.height(0.0, 0.0)])
    rotation = rotation_between(T[:3, :3].T @ slope, np.array([0.0, 0.0, 1.0]))
    return SceneFrame(
        np.column_stack([scan.xyz, scan.intensity, scan.ring]).astype(np.float32),
        scan.actor_id,
        np.array(lidar128.KINDS)[scan.kind],
        transform(rotation, np.array([0.0, 0.0, float(slope @ (T[:3, 3] - foot))])),
    )


@pytest.fixture(scope="session")
def scene_frame() -> Callable[..., SceneFrame]:
    """scene_frame(kind, seed): a turn of a random street; the same arguments give the same arrays, do not write."""

    def make(kind: str, seed: int, objects: int = 60, t_s: float = 5.0, columns: int = 1800) -> SceneFrame:
        return _scene_frame(kind, seed, objects, t_s, columns)

    return make


@pytest.fixture(scope="session")
def recording() -> Callable[[str], Path]:
    """recording("lidar128-velodyne-vls128"): the folder, or the test is skipped."""

    def find(name: str) -> Path:
        path = RECORDINGS / name
        if not path.exists():
            pytest.skip(f"no recording {path}; set SPOTTER_DATA")
        return path

    return find


@pytest.fixture(scope="session")
def plane_cloud() -> Callable[..., np.ndarray]:
    """A road of 40 m by 40 m and boxes on it, seen by a tilted sensor: (N, 3) float32 in the sensor frame."""

    def make(
        height_m: float = 5.0, roll_rad: float = 0.0, pitch_rad: float = 0.2,
        boxes: tuple[tuple[float, float, float, float, float], ...] = (), points: int = 20_000, seed: int = 0,
    ) -> np.ndarray:  # fmt: skip
        rng = np.random.default_rng(seed)
        road = np.column_stack([rng.uniform(-20, 20, (points, 2)), rng.normal(0, 0.01, points)])
        solid = [
            rng.uniform([x - a / 2, y - b / 2, 0.05], [x + a / 2, y + b / 2, h], (600, 3)) for x, y, a, b, h in boxes
        ]
        level = np.vstack([road, *solid]) - [0.0, 0.0, height_m]
        return (level @ rotation_rpy(roll_rad, pitch_rad, 0.0)).astype(np.float32)

    return make
