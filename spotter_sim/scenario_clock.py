"""The simulated world's time in a running service."""

from __future__ import annotations

from common.clock import monotonic_s, utc_ns
from common.config import ConfigError
from common.source_url import SourceUrl
from spotter_sim.world import scenario_time


class ScenarioClock:
    """Scenario time of monotonic moments: UTC modulo the scenario's length, or from ``t0`` at the start.

    The world goes on evenly whatever happens to the host's UTC clock meanwhile, as the real one does.

    Args:
        url: ``sim:SCENARIO?t0=SECONDS``.
        default: the scenario when the source names none.

    Raises:
        ConfigError: no such scenario, or ``t0`` is not a number.
    """

    def __init__(self, url: SourceUrl, default: str = "") -> None:
        self.scenario = url.target or default
        self._t0_s = url.number("t0", 0.0) if "t0" in url.params else None
        self._start_s, self._start_ns = monotonic_s(), utc_ns()
        try:
            self.at(self._start_s)
        except ValueError as error:
            raise ConfigError(f"source {url}: {error}") from None

    def at(self, moment_s: float) -> float:
        """Scenario time in [0, length) at ``moment_s`` on the monotonic clock."""
        now_ns = self._start_ns + round((moment_s - self._start_s) * 1e9)
        return scenario_time(self.scenario, now_ns, self._t0_s, self._start_ns)
