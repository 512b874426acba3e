"""Where the motion comes from: the simulated world. A wheel encoder or an odometry bus would be a scheme of its own."""

from __future__ import annotations

import time
from collections.abc import Iterator

from common.clock import monotonic_s, utc_at
from common.config import ConfigError
from common.sim.scenario_clock import ScenarioClock
from common.sim.world import world_at
from common.source_url import parse_source
from services.jetson.ego.config import EgoConfig
from services.jetson.ego.pipeline import Motion


def open_source(config: EgoConfig) -> Iterator[tuple[int, Motion]]:
    """Yield ``(stamp_ns, motion)`` at the configured rate, for ever.

    Raises:
        ConfigError: no source, an unknown scheme or an unknown scenario.
    """
    if not config.source:
        raise ConfigError('source = "": the vehicle\'s motion comes from sim:<scenario>, e.g. --source sim:crossing')
    url = parse_source(config.source, {"sim": ("t0",)})
    return _simulated(ScenarioClock(url), 1.0 / config.rate_hz)


def _simulated(clock: ScenarioClock, period_s: float) -> Iterator[tuple[int, Motion]]:
    due_s = monotonic_s()
    while True:
        now_s = monotonic_s()
        world = world_at(clock.scenario, clock.at(now_s))
        yield utc_at(now_s), Motion(world.vehicle_speed_mps, world.vehicle_yaw_rate_radps, world.T_map_vehicle)
        due_s = max(due_s + period_s, monotonic_s() - period_s)  # after a pause: go on, do not catch up
        time.sleep(max(0.0, due_s - monotonic_s()))
