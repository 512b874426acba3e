"""Streets of randomised bodies and furniture, seen from masts and from vehicles by sensors of many kinds.

The plan of each street is a generated roadside scene; who stands and drives there, what stands beside it, the mounting
and the sensor are drawn anew. What hides what, what the ground step leaves and where clustering cuts follow from that,
in the shares in which streets have them: single bodies (``varied.py``) cannot teach those.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from common.geometry import pose_2d
from services.infra_lidar.calibration.plane_fit import Calibrator
from services.infra_lidar.training.clusters import LabelledClusters
from services.infra_lidar.training.scenes import (
    CLASS_OF_KIND,
    SceneFrame,
    Steps,
    pure_clusters,
    segment_and_cluster,
    select_returns,
)
from services.infra_lidar.training.varied import MAKERS
from services.infra_lidar.training.varied_furniture import furniture
from spotter_sim.lidar128 import Scan, scan
from spotter_sim.model import Scenario
from spotter_sim.roadside import REACH_M, RoadsideKind, roadside
from spotter_sim.scene import Mount
from spotter_sim.solids import FOLIAGE, KINDS, PARTS, SCENE_ID, SPHERE, Solids, join

OBJECTS = (30, 60, 120)
PLANS: tuple[RoadsideKind, ...] = ("open", "level", "facade", "trees")
_FURNITURE = 40  # pieces a street
_FURNITURE_X_M = ((-8.0, -4.2), (-0.6, 0.6), (15.2, 16.6), (16.6, 36.0))  # behind the pole, both kerbs, the square
_LANES_X_M = (6.2, 7.8, 9.5)
_COLUMNS, _RING_STEPS = (1024, 1800, 2048), (1, 2, 2, 3, 4)  # 32 to 128 beams over 40 degrees


def varied_street_clusters(seeds: Iterable[int], steps: Steps, views: int) -> LabelledClusters:
    """Clusters of ``views`` frames of one street per seed, which is their group. Refused calibrations are left out."""

    def frames() -> Iterator[tuple[int, SceneFrame]]:
        """Each frame with its street's seed."""
        for n, seed in enumerate(seeds):
            rng = np.random.default_rng([seed, 7])
            street = varied_street(seed, OBJECTS[n % len(OBJECTS)], PLANS[n % len(PLANS)])
            for k in range(views):
                view = _sensed(rng, _seen_from(street, f"{street.name}-{k}", _mount(rng)))
                found = Calibrator(steps.calibration).add(view.xyz)
                if not found.refused:
                    yield seed, segment_and_cluster(view, steps, found.T_level_sensor)

    return pure_clusters(frames())


def varied_street(seed: int, objects: int, kind: RoadsideKind) -> Scenario:
    """A generated roadside scene at its middle, with other bodies in the same places and more furniture."""
    rng = np.random.default_rng([seed, objects])
    plan = roadside(seed, objects, kind)
    made = [plan.scene.fixtures]
    for actor in plan.at(0.5 * plan.length_s).actors:
        body = MAKERS[CLASS_OF_KIND[actor.kind]](rng)
        body = replace(body, kind=np.full(len(body), KINDS.index(actor.kind), np.uint8))
        made.append(body.placed(actor.T_map_body, actor.actor_id, np.zeros(3)))
    for _ in range(_FURNITURE):
        x = rng.uniform(*_FURNITURE_X_M[rng.integers(len(_FURNITURE_X_M))])
        y, yaw = rng.uniform(-REACH_M, REACH_M), rng.uniform(-np.pi, np.pi)
        place = pose_2d(x, y, yaw, float(plan.scene.ground.height(x, y)))
        made.append(furniture(rng).placed(place, SCENE_ID, np.zeros(3)))
    scene = replace(plan.scene, fixtures=_leafy(join(made)))
    return replace(plan, name=f"varied-{plan.name}", scene=scene, cast=())


def _leafy(solids: Solids) -> Solids:
    """Balls of leaves let some rays through."""
    leaves = (solids.part == PARTS.index("leaves")) & (solids.shape == SPHERE)
    return replace(solids, shape=np.where(leaves, FOLIAGE, solids.shape).astype(np.uint8))


def _mount(rng: np.random.Generator) -> Mount:
    """On a mast at the kerb or on the roof of a vehicle in its lane."""
    roll_rad = np.radians(rng.normal(0.0, 1.0))
    if rng.random() < 0.5:
        place, height_m, yaw_rad = (rng.uniform(-0.5, 0.5), rng.uniform(-15, 15)), rng.uniform(2.5, 9.0), 1.3
        pitch_rad = np.radians(rng.uniform(5.0, 16.0))
    else:
        place, height_m, yaw_rad = (rng.choice(_LANES_X_M), rng.uniform(-30, 30)), rng.uniform(1.6, 2.4), np.pi
        pitch_rad = np.radians(rng.uniform(-2.0, 4.0))
    return Mount(*place, height_m, rng.uniform(-yaw_rad, yaw_rad), pitch_rad, roll_rad)


def _seen_from(street: Scenario, name: str, mount: Mount) -> Scenario:
    return replace(street, name=name, scene=replace(street.scene, mount=mount))


def _sensed(rng: np.random.Generator, street: Scenario) -> Scan:
    """One revolution of a sensor with fewer beams, losses, noise and rounding of its own."""
    view = scan(street, 0.0, int(rng.choice(_COLUMNS)))
    beams = view.ring % rng.choice(_RING_STEPS) == 0
    view = select_returns(view, beams & (rng.random(len(view)) > rng.choice([0.0, 0.05, 0.2])))
    range_m = np.linalg.norm(view.xyz, axis=1)
    sigma_m, step_m = np.exp(rng.uniform(np.log(0.003), np.log(0.04))), rng.choice([0.001, 0.004, 0.01, 0.02])
    noisy_m = np.round((range_m + rng.normal(0.0, sigma_m, len(range_m))) / step_m) * step_m
    return replace(view, xyz=(view.xyz * (noisy_m / range_m)[:, None]).astype(np.float32))
