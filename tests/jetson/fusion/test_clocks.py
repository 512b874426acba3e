"""Clock offsets: the exchange of NTP, steps found by contradiction, trust lost with time, and what fusion does then."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.clock import clock_words
from services.jetson.fusion.clocks import ClockSample, ClockWatch, OwnClock, measure
from services.jetson.fusion.config import ClocksConfig
from services.jetson.fusion.dating import SenderClock

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
    health = watch.health(1.5)
    assert health is not None
    assert (health.offset_ms, health.trusted) == (4000.0, True)


def test_noise_within_the_bounds_is_no_step() -> None:
    watch = ClockWatch(CONFIG)
    for step in range(20):
        watch.add(sample(step * 0.5, 0.002 * (-1) ** step, 0.003))
    assert watch.distrust(10.0) == ""


def test_an_old_bound_widens_by_drift_and_is_lost_only_when_it_is_too_wide() -> None:
    """1 ms and 50 ppm make 100 ms after 1980 s; measurements that are wider do not help."""
    watch = ClockWatch(CONFIG)
    assert (watch.distrust(0.0), watch.health(0.0)) == ("", None)
    watch.add(sample(0.0, 0.0))
    watch.add(sample(1900.0, 0.0, bound_s=0.2))
    assert watch.distrust(1979.0) == ""
    assert watch.distrust(1981.0) == "clock offset known to 100 ms only, last measured 81 s ago"
    watch.forget()
    assert watch.distrust(1981.0) == ""


def test_a_clock_that_was_only_measured_widely_is_not_trusted() -> None:
    watch = ClockWatch(CONFIG)
    watch.add(sample(0.0, 0.3, bound_s=0.15))
    assert watch.distrust(0.0) == "clock offset known to 150 ms only, last measured 0 s ago"
    assert watch.sender(0.0) == SenderClock(0.3, 0.15)
    watch.add(sample(1.0, 0.25, bound_s=0.05))
    assert watch.distrust(1.0) == ""


@given(
    st.floats(-40e-6, 40e-6),
    st.lists(st.tuples(st.floats(0.1, 900.0), st.floats(0.0, 0.3), st.floats(-1.0, 1.0)), min_size=1, max_size=40),
)
def test_the_true_offset_stays_within_the_bound_however_old_it_is(
    drift: float, measured: list[tuple[float, float, float]]
) -> None:
    """Two quartz clocks part by up to 40 ppm; measurements of any width come at any time."""
    watch, now_s = ClockWatch(CONFIG), 0.0
    for pause_s, bound_s, error in measured:
        now_s += pause_s
        watch.add(sample(now_s, 3.0 + drift * now_s + error * bound_s, bound_s))
        for later_s in (0.0, pause_s):
            best = watch.estimate(now_s + later_s)
            assert best is not None
            assert abs(best.offset_s - (3.0 + drift * (now_s + later_s))) <= best.bound_s + 1e-9
        assert watch.distrust(now_s) == "" or best.bound_s > CONFIG.max_bound_ms * 1e-3


def test_a_step_of_our_own_clock_shifts_what_was_measured() -> None:
    watch = ClockWatch(CONFIG)
    watch.add(sample(0.0, 5.0))
    watch.shift(2.0)
    assert watch.sender(0.0) == pytest.approx(SenderClock(3.0, 0.003))
    watch.add(sample(0.5, 3.0005))
    assert watch.distrust(0.5) == ""


@pytest.mark.parametrize(
    ("steps_s", "offset_s"),
    [((-0.5,), 0.5), ((0.5,), 0.0), ((-0.5, 0.2), 0.3), ((-0.5, 0.75), 0.0), ((-0.5, -0.25), 0.75)],
)
def test_a_clock_that_was_never_measured_is_judged_by_ours_as_it_was_and_as_it_is(
    steps_s: tuple[float, ...], offset_s: float
) -> None:
    watch = ClockWatch(CONFIG)
    assert watch.sender(0.0) == SenderClock()
    for step_s in steps_s:
        watch.shift(step_s)
    assert watch.sender(0.0).offset_s == pytest.approx(offset_s)
    watch.forget()
    assert watch.sender(0.0) == SenderClock()


def test_the_limits_themselves() -> None:
    """A bound of exactly the limit counts; offsets that just touch do not contradict; exactly the step is a step."""
    config = ClocksConfig(max_bound_ms=250.0, step_ms=250.0, drift_ppm=0.0)
    watch = ClockWatch(config)
    watch.add(sample(0.0, 1.0, 0.25))
    assert watch.estimate(0.0) is not None
    watch.add(sample(1.0, 1.5, 0.25))
    assert watch.distrust(1.0) == ""
    watch.add(sample(2.0, 2.0 + 2**-20, 0.25))
    assert "stepped" in watch.distrust(2.0)
    assert ClockWatch(config).estimate(0.0) is None
    clock = OwnClock(config)
    assert clock.step(1.0, 1_000_000_000) == 0.0
    assert clock.step(2.0, 2_250_000_000) == 0.25
    wide = ClockWatch(config)
    wide.add(sample(0.0, 1.0, 0.25))
    assert wide.distrust(0.0) == ""
    wide.restart("")
    wide.forget()
    wide.add(sample(0.0, 1.0, 0.26))
    assert wide.distrust(0.0) != ""


def test_what_health_is_told() -> None:
    watch = ClockWatch(CONFIG)
    watch.add(sample(1.0, 0.25, 0.002))
    health = watch.health(1.0)
    assert health is not None
    assert (health.offset_ms, health.bound_ms, health.age_s, health.trusted) == (250.0, 2.0, 0.0, True)
    later = watch.health(3.0)
    assert later is not None
    assert later.bound_ms == pytest.approx(2.0 + 2.0 * 50e-3)
    assert later.age_s == 2.0


def test_the_tightest_measurement_is_kept_until_it_is_the_wider_one() -> None:
    watch = ClockWatch(ClocksConfig(drift_ppm=1000.0))
    watch.add(sample(0.0, 0.0, 0.001))
    watch.add(sample(0.75, 0.0005, 0.002))
    assert watch.estimate(0.75) == pytest.approx(sample(0.75, 0.0, 0.00175)._replace(at_s=0.0))
    watch.add(sample(1.0, 0.0005, 0.002))
    assert watch.estimate(1.0) == sample(1.0, 0.0005, 0.002), "as tight as the old one by now, and newer"


def test_our_own_clock() -> None:
    clock = OwnClock(CONFIG)
    assert clock.step(1.0, 1_000_000_000) == 0.0
    assert clock.step(2.0, 2_019_000_000) == 0.0
    assert clock.step(3.0, 3_019_000_000) == 0.0
    assert clock.step(4.0, 9_019_000_000) == pytest.approx(5.0)
    assert clock.step(5.0, 10_019_000_000) == 0.0


@pytest.mark.parametrize(
    ("offset_s", "words"),
    [
        (86400.0, "1 day ahead"), (-86399.0, "24 hours behind"), (1.05 * 86400.0, "1 day ahead"),
        (3600.0, "1 hour ahead"), (-3599.0, "60 minutes behind"), (1.05 * 3600.0, "1 hour ahead"),
        (60.0, "1 minute ahead"), (59.0, "59 seconds ahead"), (63.0, "1 minute ahead"),
        (1.0, "1 second ahead"), (-1.6, "2 seconds behind"), (0.6, "1 second ahead"),
    ],
)  # fmt: skip
def test_a_wrong_clock_in_words(offset_s: float, words: str) -> None:
    assert clock_words("pi0", offset_s) == f"clock of pi0 is {words}"
