"""A stand-in for the camera's network: the true boxes of a picture, with the errors and misses of a detector.

The demonstration's network knows one yard only; a network for all the world would take longer than everything else.
What is assumed here, and not measured on a network: an object of 40 pixels height in a 480-row picture that is wholly
visible is found in 97 of 100 pictures by day, 90 at dusk, 93 in rain; smaller, hidden or dark ones less often. The
sides of its box are off by 1.5 pixels and 2 per cent of its height. One picture in 600 shows a person where nobody is.
"""

from __future__ import annotations

import math

import numpy as np

from services.jetson.camera.detector import Boxes
from services.jetson.camera.letterbox import Fit
from spotter_sim.camera import TrueBox
from spotter_sim.model import WorldState, noise_rng

NAMES = ("person", "bicycle", "car", "bus", "truck")
BEST, BEST_DUSK, BEST_RAIN, DARK_AT_DUSK = 0.97, 0.90, 0.93, 0.6
HALF_FOUND_PX, SLOPE_PX = 20.0, 6.0  # height, in 480 rows, at which every second one is found
SIDE_PX, SIDE_SHARE = 1.5, 0.02
PHANTOMS = 1.0 / 600.0
DUSK_LIGHT = 0.7  # a picture with less light than this is one of dusk


class SimulatedDetector:
    """``look`` at the world first; then the camera's pipeline asks as it would ask a network."""

    names = NAMES
    provider = "simulated"

    def __init__(self) -> None:
        self._boxes = Boxes(np.empty((0, 4), np.float32), np.empty(0, np.float32), np.empty(0, int))

    def look(self, world: WorldState, seen: list[TrueBox], rows: int) -> None:
        """Decide what is found in the picture of this moment; ``rows`` is its height."""
        rng = noise_rng(world.scenario, world.t_s, "detector")
        scale = rows / 480.0
        dark = {actor.actor_id for actor in world.actors if actor.material == "dark"}
        found = [
            (_jittered(box, rng, scale), box.label)
            for box in seen
            if rng.random() < _chance(box, world, box.actor_id in dark, scale)
        ]
        if rng.random() < PHANTOMS:
            x, y, height = rng.uniform(0.0, 600.0), rng.uniform(150.0, 250.0), rng.uniform(40.0, 150.0)
            found.append((scale * np.array([x, y, x + 0.4 * height, y + height]), "person"))
        self._boxes = Boxes(
            np.array([box for box, _ in found], np.float32).reshape(-1, 4),
            np.full(len(found), 0.8, np.float32),
            np.array([NAMES.index(label) for _, label in found], int),
        )

    def preprocess(self, image: np.ndarray) -> tuple[np.ndarray, Fit]:
        """The picture as it is."""
        return image, Fit(1.0, 0, 0)

    def infer(self, blob: np.ndarray) -> np.ndarray:
        """Nothing to compute: ``look`` has decided."""
        return blob

    def postprocess(self, output: np.ndarray, fit: Fit, shape: tuple[int, ...]) -> Boxes:
        """What ``look`` found."""
        return self._boxes


def _chance(box: TrueBox, world: WorldState, dark: bool, scale: float) -> float:
    """Probability that a detector finds it."""
    if box.visible < 0.25:
        return 0.0
    height_px = (box.box_xyxy_px[3] - box.box_xyxy_px[1]) / scale
    dusk = world.weather.light < DUSK_LIGHT
    best = min(BEST_DUSK if dusk else BEST, 1.0 - (1.0 - BEST_RAIN) * world.weather.rain)
    large_enough = 1.0 / (1.0 + math.exp(-(height_px - HALF_FOUND_PX) / SLOPE_PX))
    return best * large_enough * min(1.0, box.visible / 0.6) * (DARK_AT_DUSK if dark and dusk else 1.0)


def _jittered(box: TrueBox, rng: np.random.Generator, scale: float) -> np.ndarray:
    sides = np.array(box.box_xyxy_px)
    sigma = SIDE_PX * scale + SIDE_SHARE * (sides[3] - sides[1])
    return np.asarray(sides + sigma * rng.standard_normal(4))
