"""Random streets with kerbs, crowns, gutters, verges, islands and ramps: what the calibration is judged on.

Map: the mast stands at (0, 0) behind the near kerb; the street runs along y, its carriageway begins at positive x.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from spotter_sim.model import Player, Scenario
from spotter_sim.motion import Straight
from spotter_sim.scene import Mount, Scene, bush, facade, post, tree
from spotter_sim.solids import Solids, join
from spotter_sim.street_ground import CrossSection, Ramp, StreetGround

LENGTH_S = 10.0
_NORTH = np.pi / 2
_AIMED_AT_M = (10.0, 30.0)  # where the middle of the field of view meets the road


def street(seed: int) -> Scenario:
    """A street with people, parked and driving cars, seen from a mast of 3 to 15 m; all follows from the seed."""
    rng = np.random.default_rng([seed, 8128])
    section = _section(rng)
    slope, turn = rng.uniform(0.0, 0.05), rng.uniform(-np.pi, np.pi)
    bend = rng.uniform(-2e-4, 2e-4, 2)
    ground = StreetGround(slope * np.cos(turn), slope * np.sin(turn), bend[0], bend[1], section)
    height_m = rng.uniform(3.0, 15.0)
    mount = Mount(
        x_m=0.0, y_m=0.0, height_m=height_m, yaw_rad=rng.uniform(-1.2, 1.2),
        pitch_rad=np.arctan2(height_m, rng.uniform(*_AIMED_AT_M)), roll_rad=np.radians(rng.uniform(-3.0, 3.0)),
    )  # fmt: skip
    scene = Scene(ground, join(list(_fixtures(rng, ground))), mount)
    return Scenario(f"street-{seed}", LENGTH_S, scene, tuple(_cast(rng, section)))


def _section(rng: np.random.Generator) -> CrossSection:
    near, wide = rng.uniform(0.4, 2.5), rng.uniform(5.5, 14.0)
    far = near + wide
    crown = float(rng.choice([near + 0.5 * wide, near, far], p=[0.6, 0.2, 0.2]))
    ramps = tuple(Ramp(y, rng.uniform(1.2, 3.0)) for y in (-rng.uniform(6, 15), rng.uniform(6, 15)))
    island = (crown - 0.75, crown + 0.75, 4.0, 4.0 + rng.uniform(4.0, 12.0)) if near < crown < far else None
    return CrossSection(
        kerbs_x_m=(near, far), crown_x_m=crown, crossfall=rng.uniform(0.02, 0.03), kerb_m=rng.uniform(0.06, 0.15),
        gutter_m=float(rng.choice([0.0, rng.uniform(0.3, 0.6)])), gutter_slope=rng.uniform(0.05, 0.08),
        footway_m=(near + rng.uniform(0.5, 4.0), rng.uniform(1.5, 5.0)), footway_slope=rng.uniform(0.01, 0.025),
        verge_slope=rng.uniform(0.02, 0.08), ramps=ramps if rng.random() < 0.5 else (),
        island=island if rng.random() < 0.3 else None,
    )  # fmt: skip


def _fixtures(rng: np.random.Generator, ground: StreetGround) -> Iterator[Solids]:
    """Lamp posts, trees and bushes on both sides; often house fronts."""
    section = ground.section
    (near, far), (near_foot, far_foot) = section.kerbs_x_m, section.footway_m
    for x, chance in ((far + far_foot + rng.uniform(0.5, 6.0), 0.7), (near - near_foot - rng.uniform(1.0, 6.0), 0.4)):
        if rng.random() < chance:
            yield facade((x, -60.0), (x, 60.0), rng.uniform(6.0, 12.0), rng)
    for _ in range(8):
        side, y = rng.random() < 0.5, rng.uniform(-40.0, 40.0)
        x = far + rng.uniform(0.4, far_foot) if side else near - near_foot - rng.uniform(0.0, 0.8)
        z = float(ground.height(x, y))
        kind = rng.integers(3)
        if kind == 0:
            yield post(x, y, z, 5.0, 0.08)
        else:
            yield tree(x, y, z, 5.0, rng) if kind == 1 else bush(x, y, z, 0.8, rng)


def _cast(rng: np.random.Generator, section: CrossSection) -> Iterator[Player]:
    """Cars parked at the kerbs, cars on the lanes, people on the footways."""
    near, far = section.kerbs_x_m
    number, parked = 0, rng.uniform(0.0, 0.7)
    for x in (near + 1.2, far - 1.2):
        for y in np.arange(-36.0, 37.0, 6.0):
            if far - near > 8.0 and rng.random() < parked:
                number += 1
                yield Player(number, "car", Straight((x, float(y)), _NORTH, 0.0, LENGTH_S))
    middle = 0.5 * (near + far)
    for x, yaw in ((middle - 1.6, -_NORTH), (middle + 1.6, _NORTH)):
        for y in rng.uniform(-45.0, 45.0, 2):
            number += 1
            yield Player(number, "car", Straight((x, float(y)), yaw, rng.uniform(4.0, 12.0), LENGTH_S))
    for _ in range(12):
        number += 1
        x = near - rng.uniform(0.3, 2.0) if rng.random() < 0.5 else far + rng.uniform(0.3, section.footway_m[1])
        yield Player(number, "pedestrian", Straight((float(x), rng.uniform(-30, 30)), _NORTH, 1.2, LENGTH_S))
