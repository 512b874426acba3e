"""Clock offsets: the exchange of NTP, steps found by contradiction, trust lost with time, and what fusion does then."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.jetson.fusion.clocks import ClockSample, ClockWatch, OwnClock, measure
from services.jetson.fusion.config import ClocksConfig

CONFIG = ClocksConfig()


def sample(at_s: float, offset_s: float, bound_s: float = 0.001) -> ClockSample:
    return ClockSample("pi0/radar", at_s, offset_s, bound_s)


def test_the_worked_exchange() -> None:
    """Theirs is 5 s ahead; 2 ms out, 1 ms in between, 4 ms back: offset 5 s - 1 ms, true within 3 ms."""
    one = measure("pi0/radar", 1.0, 0, 5_002_000_000, 5_003_000_000, 7_000_000)
    assert one.offset_s == pytest.approx(4.999)
    assert one.bound_s == pytest.approx(0.003)


@given(st.floats(-100, 100), st.floats(0, 0.2), st.floats(0, 0.2), st.floats(0, 0.05))
def test_the_true_offset_is_always_within_the_bound(
    offset_s: float, out_s: float, back_s: float, busy_s: float
) -> None:
    t1, t2 = out_s + offset_s, out_s + busy_s + offset_s
    t3 = out_s + busy_s + back_s
    one = measure("x", 0.0, 0, *(round(t * 1e9) for t in (t1, t2, t3)))
    assert abs(one.offset_s - offset_s) <= one.bound_s + 1e-8


def test_the_tightest_measurement_counts_and_widens_with_drift() -> None:
    watch = ClockWatch(CONFIG)
    watch.add(sample(0.0, 0.010, 0.001))
    watch.add(sample(1.0, 0.012, 0.005))
    best = watch.estimate(1.0)
    assert best is not None
    assert best.offset_s == 0.010
    assert best.bound_s == pytest.approx(0.001 + 50e-6)


def test_a_contradiction_is_a_step_and_trust_comes_back() -> None:
    watch = ClockWatch(CONFIG)
    watch.add(sample(0.0, 0.0))
    assert watch.distrust(0.0) == ""
    watch.add(sample(0.5, 4.0))
    assert "stepped by +4.000 s" in watch.distrust(0.5)
    watch.add(sample(1.0, 4.0))
    assert watch.distrust(1.0)
    watch.add(sample(1.5, 4.0))
    assert watch.distrust(1.5) == ""
    told = watch.health(1.5)
    assert told is not None
    assert (told.offset_ms, told.trusted) == (4000.0, True)


def test_noise_within_the_bounds_is_no_step() -> None:
    watch = ClockWatch(CONFIG)
    for step in range(20):
        watch.add(sample(step * 0.5, 0.002 * (-1) ** step, 0.003))
    assert watch.distrust(10.0) == ""


def test_the_bound_is_lost_with_time_and_wide_measurements_do_not_count() -> None:
    watch = ClockWatch(CONFIG)
    assert (watch.distrust(0.0), watch.health(0.0)) == ("", None)
    watch.add(sample(0.0, 0.0))
    watch.add(sample(9.0, 0.0, bound_s=0.2))
    assert watch.distrust(10.0) == ""
    assert "not measured for 11 s" in watch.distrust(11.0)
    watch.forget()
    assert watch.distrust(11.0) == ""


def test_the_limits_themselves() -> None:
    """A bound of exactly the limit counts; offsets that just touch do not contradict; exactly the step is a step."""
    config = ClocksConfig(max_bound_ms=250.0, step_ms=250.0, drift_ppm=0.0)
    watch = ClockWatch(config)
    watch.add(sample(0.0, 1.0, 0.25))
    assert watch.estimate(0.0) is not None
    watch.add(sample(1.0, 1.5, 0.25))
    assert watch.distrust(1.0) == ""
    watch.add(sample(2.0, 1.5 + 2**-20, 0.25))
    assert "stepped" in watch.distrust(2.0)
    assert ClockWatch(config).estimate(0.0) is None
    clock = OwnClock(config)
    assert clock.step(1.0, 1_000_000_000) == 0.0
    assert clock.step(2.0, 2_250_000_000) == 0.25
    wide = ClockWatch(config)
    wide.add(sample(0.0, 1.0, 0.26))
    assert wide.estimate(0.0) is None


def test_what_health_is_told() -> None:
    watch = ClockWatch(CONFIG)
    watch.add(sample(1.0, 0.25, 0.002))
    told = watch.health(1.0)
    assert told is not None
    assert (told.offset_ms, told.bound_ms, told.age_s, told.trusted) == (250.0, 2.0, 0.0, True)
    later = watch.health(3.0)
    assert later is not None
    assert later.bound_ms == pytest.approx(2.0 + 2.0 * 50e-3)
    assert later.age_s == 2.0


def test_only_the_newest_sixteen_measurements_count() -> None:
    watch = ClockWatch(ClocksConfig(drift_ppm=0.0))
    watch.add(sample(0.0, 0.0, 0.001))
    for step in range(1, 16):
        watch.add(sample(float(step), 0.0005, 0.002))
    assert watch.estimate(15.0) == sample(0.0, 0.0, 0.001)
    watch.add(sample(16.0, 0.0005, 0.002))
    best = watch.estimate(16.0)
    assert best is not None
    assert best.bound_s == 0.002


def test_our_own_clock() -> None:
    clock = OwnClock(CONFIG)
    assert clock.step(1.0, 1_000_000_000) == 0.0
    assert clock.step(2.0, 2_019_000_000) == 0.0
    assert clock.step(3.0, 3_019_000_000) == 0.0
    assert clock.step(4.0, 9_019_000_000) == pytest.approx(5.0)
    assert clock.step(5.0, 10_019_000_000) == 0.0


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
    assert {told.state for told in bench.health.sensors.values()} == {"online"}
    bench.until(lambda: bench.health.colour == "green", 2.0)
    assert bench.verdict.level == "SAFE"


def test_a_bound_that_was_there_and_is_lost_raises_the_floor(bench: Any) -> None:
    bench.answers_clock = False
    bench.run(9.0)
    assert bench.verdict.level == "SAFE"
    bench.run(2.0)
    assert bench.is_in("radar", "degraded", "clock")
    assert bench.verdict.level == "CAUTION"


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
