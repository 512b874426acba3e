"""Where the motion comes from: the simulated world. A wheel encoder or an odometry bus would be a scheme of its own."""

from __future__ import annotations

import time
from collections.abc import Iterator

from common.clock import monotonic_s, utc_ns
from common.config import ConfigError
from common.sim.world import scenario_time, world_at
from common.source_url import SourceUrl, parse_source
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
    return _simulated(url, _checked(url), 1.0 / config.rate_hz)


def _checked(url: SourceUrl) -> float | None:
    """The start time of the scenario, or None for the wall clock's."""
    t0_s = url.number("t0", 0.0) if "t0" in url.params else None
    try:
        world_at(url.target, 0.0)
    except ValueError as error:
        raise ConfigError(f"source {url}: {error}") from None
    return t0_s


def _simulated(url: SourceUrl, t0_s: float | None, period_s: float) -> Iterator[tuple[int, Motion]]:
    started_ns, due_s = utc_ns(), monotonic_s()
    while True:
        now_ns = utc_ns()
        world = world_at(url.target, scenario_time(url.target, now_ns, t0_s, started_ns))
        yield now_ns, Motion(world.vehicle_speed_mps, world.vehicle_yaw_rate_radps, world.T_map_vehicle)
        due_s = max(due_s + period_s, monotonic_s() - period_s)  # after a pause: go on, do not catch up
        time.sleep(max(0.0, due_s - monotonic_s()))
