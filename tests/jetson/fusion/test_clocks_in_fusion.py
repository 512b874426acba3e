"""What a clock that is wrong, steps or cannot be measured means for states and verdict, in simulated time."""

from __future__ import annotations

from typing import Any

import pytest

from common.codec import decode, encode
from common.messages import SystemHealth, Verdict
from services.jetson.fusion.config import ClocksConfig, FusionConfig


def test_a_pi_with_a_wrong_clock_is_corrected_and_told(new_bench: Any) -> None:
    bench = new_bench()
    bench.clock_s["radar"] = 49.0
    bench.run(3.0)
    assert bench.is_in("radar", "online")
    assert bench.sensor("radar").age_ms < 200.0
    assert bench.health.clocks["pi0/radar"].offset_ms == pytest.approx(49_000.0)
    assert any("clock of pi0/radar is +49.000 s from ours" in note for note in bench.health.notes)


@pytest.mark.parametrize("step_s", [5.0, -5.0, 0.3, -0.3])
def test_a_step_of_a_sensors_clock_raises_the_floor_until_it_is_measured_again(bench: Any, step_s: float) -> None:
    bench.clock_s["radar"] = step_s
    levels = set()
    bench.until(lambda: levels.add(bench.tick().level) or not bench.is_in("radar", "online"), 1.0)
    assert bench.sensor("radar").cause in ("clock", "stale")
    bench.until(lambda: bench.is_in("radar", "online"), 3.0)
    assert bench.verdict.level == "SAFE"
    assert bench.health.clocks["pi0/radar"].offset_ms == pytest.approx(step_s * 1e3)
    if step_s == 5.0:
        assert any(v.rule == "C1-clock" and v.level == "CAUTION" for v in bench.verdicts)


@pytest.mark.parametrize("step_s", [3.0, -3.0, 0.05])
def test_a_step_of_our_own_clock_raises_the_floor_and_no_sensor_is_blamed(bench: Any, step_s: float) -> None:
    bench.our_clock_s = step_s
    bench.tick()
    assert (bench.verdict.level, bench.verdict.rule, bench.verdict.blind) == ("CAUTION", "C1-clock", False)
    assert f"our own clock stepped by {step_s:+.3f} s" in bench.verdict.because
    assert (bench.health.colour, bench.health.summary[:17]) == ("amber", "CLOCK NOT TRUSTED")
    first = len(bench.verdicts)
    bench.until(lambda: bench.health.colour == "green", 2.0)
    assert bench.verdict.level == "SAFE"
    for verdict in bench.verdicts[first - 1 :]:
        assert {sensor.state for sensor in verdict.inputs.values()} == {"online"}


def test_a_bound_that_was_there_and_is_lost_raises_the_floor(new_bench: Any) -> None:
    """1 ms, and 1000 ppm: 10 ms after 9 s."""
    bench = new_bench(FusionConfig(clocks=ClocksConfig(drift_ppm=1000.0, max_bound_ms=10.0)))
    bench.run(1.0)
    bench.answers_clock = False
    bench.run(8.5)
    assert bench.verdict.level == "SAFE"
    bench.run(1.5)
    assert bench.is_in("radar", "degraded", "clock")
    assert bench.verdict.level == "CAUTION"
    assert "clock offset known to" in bench.sensor("radar").reason


@pytest.mark.parametrize("round_trip_s", [0.12, 0.3, 2.0])
def test_a_slow_link_with_data_in_time_still_serves(bench: Any, round_trip_s: float) -> None:
    """The bound from before it became slow is widened by 50 ppm; wide measurements take nothing away."""
    bench.clock_bound_s = round_trip_s / 2
    bench.delay_s["radar"] = min(round_trip_s / 2, 0.3)
    first = len(bench.verdicts)
    bench.run(60.0)
    assert {verdict.level for verdict in bench.verdicts[first:]} == {"SAFE"}
    assert bench.is_in("radar", "online")
    assert bench.health.clocks["pi0/radar"].bound_ms < 5.0


def test_a_link_that_was_always_slow_serves_within_what_is_known(new_bench: Any) -> None:
    bench = new_bench()
    bench.clock_bound_s, bench.delay_s["radar"] = 0.09, 0.1
    assert bench.run(20.0).level == "SAFE"
    bench = new_bench()
    bench.clock_bound_s = 0.15
    bench.run(5.0)
    assert bench.is_in("radar", "degraded", "clock")
    assert "known to 150 ms only" in bench.sensor("radar").reason


@pytest.mark.parametrize(("step_s", "delay_s"), [(-0.5, 0.65), (-0.5, 0.95), (-30.0, 0.65), (-0.2, 0.6)])
def test_data_over_its_limit_is_not_used_because_our_own_clock_went_back(
    new_bench: Any, step_s: float, delay_s: float
) -> None:
    """The radar's clock was never measured: by our clock as it is now its data looks in time, as it was it did not."""
    bench = new_bench()
    bench.answers_clock = False
    bench.run(1.0)
    bench.delay_s["radar"] = delay_s
    bench.run(1.0)
    assert bench.is_in("radar", "disconnected", "stale")
    bench.our_clock_s = step_s
    for _ in range(100):
        verdict = bench.tick()
        assert verdict.inputs["radar"].state == "disconnected"
        assert not verdict.inputs["radar"].used
    bench.answers_clock, bench.delay_s["radar"] = True, 0.02
    bench.until(lambda: bench.is_in("radar", "online"), 2.0)


def test_our_clock_set_right_before_anything_was_measured_costs_nothing(new_bench: Any) -> None:
    """It was 56 years behind, as a clock without a battery is: then all data came from the future."""
    bench = new_bench()
    bench.answers_clock, bench.our_clock_s = False, -YEARS_56_S
    bench.run(1.0)
    bench.our_clock_s = 0.0
    bench.run(2.0)
    assert bench.is_in("radar", "online")
    assert bench.verdict.level == "SAFE"


def test_a_host_that_never_answered_is_judged_by_its_stamps(new_bench: Any) -> None:
    bench = new_bench()
    bench.answers_clock = False
    bench.run(20.0)
    assert bench.verdict.level == "SAFE"
    bench.clock_s["radar"] = 1.0
    bench.run(0.2)
    assert bench.is_in("radar", "degraded", "clock")
    assert "in the future" in bench.sensor("radar").reason
    bench.clock_s["radar"] = -1.0
    bench.run(1.0)
    assert bench.is_in("radar", "disconnected", "stale")
    assert "comes late" in bench.sensor("radar").reason


YEARS_56_S = 56 * 365.25 * 86400


@pytest.mark.parametrize(("offset_s", "word"), [(-YEARS_56_S, "56 years behind"), (3 * 86400.0, "3 days ahead")])
def test_a_host_without_a_clock_is_named_and_corrected_for(bench: Any, offset_s: float, word: str) -> None:
    bench.kill("radar")
    bench.run(1.0)
    bench.clock_s["radar"] = offset_s
    bench.start("radar")
    bench.run(4.0)
    assert f"clock of pi0 is {word}; ages are corrected for it" in bench.health.notes
    assert bench.is_in("radar", "online")
    decode(encode(bench.health), SystemHealth)
    decode(encode(bench.verdict), Verdict)


@pytest.mark.parametrize(
    ("offset_s", "word", "state"),
    [
        (-YEARS_56_S, "56 years behind", "disconnected"),
        (3 * 86400.0, "3 days ahead", "degraded"),
        (3700.0, "1 hour ahead", "degraded"),
    ],
)
def test_a_clock_that_cannot_be_measured_is_the_cause(bench: Any, offset_s: float, word: str, state: str) -> None:
    bench.answers_clock = False
    bench.kill("radar")
    bench.run(1.0)
    bench.clock_s["radar"] = offset_s
    bench.start("radar")
    bench.run(4.0)
    assert bench.is_in("radar", state, "clock")
    assert bench.sensor("radar").reason == f"clock of pi0 is {word}"
    decode(encode(bench.health), SystemHealth)
    decode(encode(bench.verdict), Verdict)
