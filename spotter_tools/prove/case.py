"""A case of the proving ground is data; its result is an ``Outcome``."""

from __future__ import annotations

from dataclasses import dataclass, field

from spotter_sim.model import Fault, Scenario
from spotter_sim.vehicle import CART, MODEL_CAR, Chassis

BEGINS_S = 3.5  # before this the vehicle is carried along its way while sensors settle; then the gate has the brakes
FAILS_S = 0.5  # a sensor that is out fails at this time: it has been seen before

# What is out, by the name in the tables: faults of the simulated devices.
OUT: dict[str, tuple[str, ...]] = {
    "none": (),
    "lidar": ("lidar_unplugged",),
    "lidar dirty": ("lidar_blocked",),
    "radar": ("radar_silent",),
    "camera": ("camera_unplugged",),
    "camera dark": ("camera_dark",),
    "lidar+camera": ("lidar_unplugged", "camera_unplugged"),
    "lidar+radar": ("lidar_unplugged", "radar_silent"),
    "radar+camera": ("radar_silent", "camera_unplugged"),
}


@dataclass(frozen=True)
class Preset:
    """A vehicle: its chassis, and what its brakes and drive do."""

    chassis: Chassis
    brake_mps2: float  # with STOP
    slow_mps2: float  # on the way down to a speed limit
    accel_mps2: float
    dead_time_s: float  # from the actuator's order until the brakes bite
    slow_mps: float  # the gate's limit with SLOW
    go_mps: float


PRESETS = {
    "model": Preset(MODEL_CAR, 3.0, 2.0, 1.5, 0.05, slow_mps=0.5, go_mps=6.0),
    "cart": Preset(CART, 4.0, 2.5, 1.5, 0.10, slow_mps=1.0, go_mps=8.0),
}


@dataclass(frozen=True, eq=False)
class Case:
    """One test drive. ``scenario.vehicle`` is what a driver who sees nothing would do: the brakes only hold it back.

    Everything is in the scenario's own time; the gate has the brakes from ``BEGINS_S`` on.
    """

    name: str
    family: str
    scenario: Scenario
    dangerous: bool  # unbraked, the vehicle hits something
    seed: int = 0
    preset: str = "model"
    ends_s: float = BEGINS_S + 8.0
    out: str = "none"  # a key of OUT
    ego: bool = True  # a source of the vehicle's own motion is fitted
    tags: tuple[str, ...] = field(default=())  # of its conditions: day, dusk, rain

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Of the devices that are out, from ``FAILS_S`` to the end."""
        return tuple(Fault(name, FAILS_S, self.ends_s + 100.0) for name in OUT[self.out])


@dataclass(frozen=True)
class Outcome:
    """What came of a drive. Times are counted from ``BEGINS_S``; None = never."""

    collided: bool
    impact_mps: float  # speed of the vehicle relative to what it hit, along the line between them; 0 without contact
    min_gap_m: float
    first_caution_s: float | None
    first_imminent_s: float | None
    stopped_s: float | None
    alarm_s: float  # how long the verdict was not SAFE
    false_alarm_s: float  # of that, while nothing was on its way to the vehicle's outline
    imminent_s: float = 0.0
    drive_s: float = 0.0  # how long the vehicle was under way with the gate in charge
    false_brakes: int = 0  # times at which the brakes were applied while nothing was on its way
    closing_mps: float = 0.0  # what the impact would have been without brakes
    limited_mps: float | None = None  # the lowest speed limit in force a second before the unbraked contact
    over_limit_s: float = 0.0  # faster than the verdict's max_safe_speed_mps, beyond what braking takes
