"""The simulated world goes on evenly; stamps follow the host's UTC clock."""

from __future__ import annotations

import pytest

from common import clock
from common.config import ConfigError
from common.source_url import parse_source
from spotter_sim import scenario_clock
from spotter_sim.scenario_clock import ScenarioClock
from spotter_sim.world import SCENARIOS, scenario_time

SCHEMES = {"sim": ("t0",)}
NOW_NS = 1_700_000_000_250_000_000


def of(text: str, monkeypatch: pytest.MonkeyPatch) -> ScenarioClock:
    """Started when the monotonic clock said 100 s and UTC ``NOW_NS``."""
    monkeypatch.setattr(scenario_clock, "monotonic_s", lambda: 100.0)
    monkeypatch.setattr(scenario_clock, "utc_ns", lambda: NOW_NS)
    return ScenarioClock(parse_source(text, SCHEMES), "crossing")


def test_without_t0_it_is_utc_so_that_all_services_see_the_same_world(monkeypatch: pytest.MonkeyPatch) -> None:
    one = of("sim:crossing", monkeypatch)
    assert one.at(100.0) == scenario_time("crossing", NOW_NS)
    assert one.at(103.5) == pytest.approx(scenario_time("crossing", NOW_NS + 3_500_000_000), abs=1e-6)


def test_with_t0_it_counts_from_the_start_and_wraps(monkeypatch: pytest.MonkeyPatch) -> None:
    one = of("sim:faults?t0=4", monkeypatch)
    assert one.at(100.0) == pytest.approx(4.0)
    assert one.at(100.0 + SCENARIOS["faults"].length_s) == pytest.approx(4.0)


def test_a_clock_that_steps_does_not_move_the_world(monkeypatch: pytest.MonkeyPatch) -> None:
    one = of("sim:", monkeypatch)
    before = one.at(101.0)
    monkeypatch.setattr(scenario_clock, "utc_ns", lambda: NOW_NS - 10**12)
    assert one.at(101.0) == before


def test_an_unknown_scenario_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="sim:volcano"):
        of("sim:volcano", monkeypatch)


def test_a_moment_in_utc_follows_the_utc_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock, "monotonic_s", lambda: 100.0)
    monkeypatch.setattr(clock, "utc_ns", lambda: NOW_NS)
    assert clock.utc_at(99.75) == NOW_NS - 250_000_000
    monkeypatch.setattr(clock, "utc_ns", lambda: NOW_NS + 30_000_000_000)
    assert clock.utc_at(99.75) == NOW_NS + 29_750_000_000
