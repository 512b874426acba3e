"""What physics allows: the unbraked drive, and that of a perfect sensor which brakes 0.1 s after it can know.

The perfect sensor looks from the camera's place, in all directions, through nothing that is opaque; it measures
positions and velocities without error and expects everyone to go on as they do. It brakes as hard as the vehicle can
as soon as that ends in a contact within the time that it needs to stop and ``MARGIN_S``. A case that even it hits is
not one that can be avoided.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spotter_sim.contact import contact_s, gap_m
from spotter_sim.model import Actor, WorldState
from spotter_sim.raycast import cast
from spotter_sim.solids import KINDS, Solids
from spotter_tools.prove.braked import FREE, Order
from spotter_tools.prove.case import BEGINS_S, PRESETS, Case
from spotter_tools.prove.loop import WATCH_S, closing_mps, moving_world

REACTION_S, MARGIN_S = 0.1, 1.0
_LOOKS_S = 0.1
_RANGE_M = 40.0


@dataclass(frozen=True)
class Yardstick:
    """Times are of the scenario; None = never."""

    contact_s: float | None  # of the unbraked vehicle
    closing_mps: float  # at that contact
    known_s: float | None  # when a perfect sensor knows
    avoidable: bool  # it need not come to a contact


def measure(case: Case) -> Yardstick:
    """Drive the case twice without any sensor of ours: not braked, and braked by the perfect one."""
    contact, closing, known = _unbraked(case)
    if contact is None:
        return Yardstick(None, 0.0, known, avoidable=True)
    return Yardstick(contact, closing, known, known is not None and _braked_from(case, known + REACTION_S))


def _unbraked(case: Case) -> tuple[float | None, float, float | None]:
    """When it touches, how fast, and since when that could be known."""
    scenario, vehicle = moving_world(case)
    gaps: list[tuple[float, float]] = []
    known_s, look_s = None, BEGINS_S
    while vehicle.now_s < case.ends_s:
        vehicle.advance(vehicle.now_s + WATCH_S, FREE)
        world = scenario.at(vehicle.now_s)
        gaps.append((vehicle.now_s, gap_m(world)))
        if case.dangerous and known_s is None and vehicle.now_s >= look_s:
            look_s = vehicle.now_s + _LOOKS_S
            known_s = (
                vehicle.now_s if contact_s(visible(world), _horizon_s(case, vehicle.speed_mps)) is not None else None
            )
        if gaps[-1][1] <= 0.0 and vehicle.now_s > BEGINS_S:
            return vehicle.now_s, closing_mps(gaps), known_s
    return None, 0.0, known_s


def _horizon_s(case: Case, speed_mps: float) -> float:
    return speed_mps / PRESETS[case.preset].brake_mps2 + REACTION_S + MARGIN_S


def _braked_from(case: Case, from_s: float) -> bool:
    """Whether full brakes from ``from_s`` on keep the vehicle off everything."""
    scenario, vehicle = moving_world(case)
    stop = Order(0.0, PRESETS[case.preset].brake_mps2)
    while vehicle.now_s < case.ends_s:
        vehicle.advance(vehicle.now_s + WATCH_S, stop if vehicle.now_s >= from_s else FREE)
        if vehicle.now_s > BEGINS_S and gap_m(scenario.at(vehicle.now_s)) <= 0.0:
            return False
    return True


def visible(world: WorldState) -> WorldState:
    """The same world with only those actors in it of whom something can be seen from the vehicle."""
    if not world.actors:
        return world
    eye = (world.T_map_vehicle @ world.chassis.T_vehicle_camera)[:3, 3]
    solids = world.solids_near(eye, _RANGE_M)
    solids = solids.take(solids.kind != KINDS.index("ground"))
    return replace(world, actors=tuple(actor for actor in world.actors if _seen(actor, eye, solids)))


def _seen(actor: Actor, eye: np.ndarray, solids: Solids) -> bool:
    """A ray to the middle of one of its parts meets it first."""
    way = actor.solids.centre_m - eye
    _, index = cast(eye, way / np.linalg.norm(way, axis=1)[:, None], solids, _RANGE_M)
    return bool(np.any((index >= 0) & (solids.owner[index] == actor.actor_id)))
