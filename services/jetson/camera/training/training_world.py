"""Random simulated places and moments to train the demo network on: what is to be found, and what is not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from services.jetson.camera.letterbox import letterbox
from spotter_sim import camera, crossing, scene
from spotter_sim.bodies import DEFAULT_SIZE_M
from spotter_sim.model import Player, Scenario
from spotter_sim.motion import Pose
from spotter_sim.solids import Solids, join


class Canvas(NamedTuple):
    """The network's input size and its classes."""

    width_px: int
    height_px: int
    names: tuple[str, ...]


@dataclass(frozen=True)
class Moments:
    """A motion that is somewhere else in every second: one scenario gives many different pictures."""

    poses: tuple[Pose, ...]

    def at(self, t_s: float) -> Pose:
        """The pose of the second in which ``t_s`` lies."""
        return self.poses[int(t_s) % len(self.poses)]


def training_set(
    scenarios: int, pictures: int, canvas: Canvas, rng: np.random.Generator
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Inputs (N, 3, H, W) uint8 RGB and, per picture, boxes (M, 6): class, x1, y1, x2, y2 in input px, visible."""
    inputs, labels = [], []
    for number in range(scenarios):
        scenario = random_scenario(f"training {number}", pictures, rng)
        for second in range(pictures):
            t_s = second + 0.5
            blob, fit = letterbox(camera.image(scenario, t_s), canvas.width_px, canvas.height_px)
            found = [
                (
                    canvas.names.index(box.label),
                    *(np.array(box.box_xyxy_px) * fit.scale + [fit.left_px, fit.top_px] * 2),
                    box.visible,
                )
                for box in camera.boxes(scenario, t_s)
            ]
            inputs.append((blob[0] * 255).round().astype(np.uint8))
            labels.append(np.array(found, np.float32).reshape(-1, 6))
    return np.stack(inputs), labels


def random_scenario(name: str, seconds: int, rng: np.random.Generator) -> Scenario:
    """The demonstration's yard or a random place, with up to six actors anywhere ahead, often none."""
    place = crossing.yard_and_street() if rng.random() < 0.5 else random_place(rng)
    cast = []
    for slot in range(6):
        kind = str(rng.choice(["pedestrian", "pedestrian", "car", "car", "cyclist", "bus", "truck"]))
        poses = tuple(random_pose(kind, rng) for _ in range(seconds))
        length_m, width_m, height_m = np.array(DEFAULT_SIZE_M[kind]) * rng.uniform(0.85, 1.15, 3)
        size_m = (float(length_m), float(width_m), float(height_m))
        if kind == "car" and rng.random() < 0.5:
            size_m = crossing.SMALL_CAR_SIZE_M
        cast.append(Player(int(rng.integers(0, 10_000)) * 6 + slot, kind, Moments(poses), size_m))
    return Scenario(name, float(seconds), place, tuple(cast))


def random_pose(kind: str, rng: np.random.Generator) -> Pose:
    """In half of the moments behind the camera; else ahead, near ones more often, at any heading."""
    if rng.random() < 0.55:
        return Pose(-50.0, 0.0, 0.0)
    nearest_m = {"pedestrian": 0.7, "cyclist": 1.3, "car": 1.7}.get(kind, 6.0)
    x_m = nearest_m + 11.0 * rng.random() ** 1.7
    y_m = x_m * rng.uniform(-0.75, 0.75)
    yaw_rad = np.pi * rng.integers(0, 2) + rng.normal(0, 0.2) if rng.random() < 0.4 else rng.uniform(-np.pi, np.pi)
    speed_mps = rng.uniform(0.0, 1.5)
    return Pose(x_m, y_m, float(yaw_rad), speed_mps, 0.0, rng.uniform(0.0, 20.0))


def random_place(rng: np.random.Generator) -> scene.Scene:
    """Walls, posts, trees, bushes and house fronts where a place may have them: what is not to be detected."""
    parts: list[Solids] = [scene.facade((rng.uniform(14, 30), -60.0), (rng.uniform(14, 30), 60.0), 9.0, rng)]
    for _ in range(rng.integers(0, 5)):
        x, y, long, thick = rng.uniform(2, 9), rng.uniform(-7, 7), rng.uniform(0.5, 6), rng.uniform(0.1, 0.5)
        size = (long, thick) if rng.random() < 0.5 else (thick, long)
        if abs(y) > 1.2 or x > 4:
            parts.append(scene.wall((x, x + size[0]), (y, y + size[1]), rng.uniform(0.4, 2.5)))
    for _ in range(rng.integers(0, 6)):
        parts.append(
            scene.post(rng.uniform(1.5, 12), rng.uniform(-6, 6), 0.0, rng.uniform(0.6, 5), rng.uniform(0.03, 0.12))
        )
    for _ in range(rng.integers(0, 3)):
        parts.append(scene.tree(rng.uniform(4, 18), rng.uniform(-9, 9), 0.0, rng.uniform(3, 8), rng))
        parts.append(scene.bush(rng.uniform(3, 12), rng.uniform(-6, 6), 0.0, rng.uniform(0.4, 1.0), rng))
    return scene.Scene(scene.Ground(), join(parts), scene.Mount(x_m=-20.0, y_m=0.0))
