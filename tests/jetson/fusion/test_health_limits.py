"""One sensor's watch to the letter: on each side of every limit, and what it tells."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from common.bus.pubsub import Received
from common.messages import ServiceStatus
from common.topics import RADAR_TRACKS
from services.jetson.fusion.config import HealthConfig
from services.jetson.fusion.dating import Age, SenderClock
from services.jetson.fusion.health import DatedStatus, LinkState, SensorWatch

# Times are multiples of 1/8 s, so that sums and limits are exact.
START_NS = 1_800_000_000_000_000_000
CONFIG = HealthConfig(recovery_frames=2, future_s=0.125, rate_window_s=2.0)
THERE = LinkState(instances=("a",))


class Run:
    """A radar that is watched; every message has the next number."""

    def __init__(self, messages: Any, config: HealthConfig = CONFIG) -> None:
        self.watch = SensorWatch("radar", "pi0", RADAR_TRACKS, config)
        self._build, self._seq = messages.radar, 0

    def take(
        self, at_s: float, *, old_s: float = 0.0, around: LinkState = THERE, level: str = "SAFE", **more: Any
    ) -> None:
        """A message arrives at ``at_s``, measured ``old_s`` before by the sensor's clock."""
        arrived_ns = START_NS + round(at_s * 1e9)
        message = self._build(arrived_ns - round(old_s * 1e9), level, **more)
        message.seq = self._seq = self._seq + 1
        assert self.watch.take(Received("pi0/radar/tracks", message, at_s, arrived_ns), around) == ""

    def judge(self, at_s: float, around: LinkState = THERE) -> Any:
        """What is told of the sensor at ``at_s``."""
        return self.watch.judge(at_s, START_NS + round(at_s * 1e9), around)[1]

    def online(self) -> Run:
        """After two good frames, the second at 8.125 s."""
        self.take(8.0)
        self.take(8.125)
        assert self.judge(8.125).state == "online"
        return self


@pytest.fixture
def run(messages: Any) -> Run:
    return Run(messages)


def status(at_s: float, state: Any, reason: str = "", old_s: float = 0.0) -> DatedStatus:
    message = ServiceStatus(
        stamp_ns=1, state=state, reason=reason, published=0, dropped=0, bad_input=0, rate_hz=0.0,
        last_frame_age_s=None, stage_ms={}, rss_mb=1.0,
    )  # fmt: skip
    return DatedStatus(Received("pi0/radar/status", message, at_s, START_NS), Age(at_s, old_s))


def test_a_new_watch_is_disconnected_since_it_was_first_asked(run: Run) -> None:
    health = run.judge(1.0)
    assert (health.state, health.cause, health.since_ns) == ("disconnected", "waiting", START_NS + 10**9)
    assert (health.age_ms, health.rate_hz) == (None, 0.0)
    assert run.judge(2.0).since_ns == START_NS + 10**9


def test_the_first_good_frames_are_counted_from_nothing(run: Run) -> None:
    run.take(8.0)
    assert run.judge(8.0).reason == "recovering, 1 of 2 good frames"
    run.take(8.125)
    assert run.judge(8.125).state == "online"


def test_the_first_fresh_frames_of_an_impaired_sensor_are_counted_from_nothing(run: Run) -> None:
    run.take(8.0, state="degraded", reason="saturated")
    assert run.judge(8.0).reason == "recovering, 1 of 2 good frames; saturated"
    run.take(8.125, state="degraded", reason="saturated")
    assert run.judge(8.125).state == "degraded"


def test_an_impaired_frame_starts_the_good_ones_again(run: Run) -> None:
    run.take(8.0, state="degraded", reason="saturated")
    run.take(8.125)
    assert run.judge(8.125).reason == "recovering, 1 of 2 good frames"


def test_a_frame_that_came_late_starts_the_fresh_ones_again(run: Run) -> None:
    run.take(8.0, old_s=1.0)
    run.take(8.125, state="degraded", reason="saturated")
    assert run.judge(8.125).state == "disconnected"


def test_exactly_as_old_as_the_limit_is_in_time(run: Run) -> None:
    run.online()
    assert run.judge(8.625).state == "online"
    assert run.judge(8.75).cause == "stale"
    run.take(9.0, old_s=0.5)
    run.take(9.125, old_s=0.5)
    assert run.judge(9.125).state == "online"


def test_exactly_as_far_ahead_as_allowed_is_no_clock_fault(run: Run) -> None:
    run.online()
    run.take(8.25, old_s=-0.125)
    assert run.judge(8.25).state == "online"
    run.take(8.375, old_s=-0.25)
    assert run.judge(8.375).cause == "clock"


def test_the_clocks_offset_counts(run: Run) -> None:
    run.take(8.0, old_s=0.25, around=THERE)
    assert run.watch.age_s(8.0) == 0.25
    run.take(8.125, old_s=0.25, around=replace(THERE, clock=SenderClock(-0.25)))
    assert run.watch.age_s(8.125) == 0.0
    assert run.watch.age_s(8.375) == 0.25


def test_data_that_may_be_over_its_limit_is_stale(run: Run) -> None:
    """The clock is known to 125 ms: 0.375 s may be 0.5 s, which is in time; 0.5 s may be 0.625 s, which is not."""
    around = replace(THERE, clock=SenderClock(0.0, 0.125))
    for at_s in (8.0, 8.125):
        run.take(at_s, old_s=0.125, around=around)
    assert run.judge(8.375, around).state == "online"
    health = run.judge(8.5, around)
    assert (health.state, health.cause) == ("disconnected", "stale")
    assert health.reason == "stale: data may be 0.62 s old (limit 0.5 s), its clock is known to 125 ms only"


@pytest.mark.parametrize(("old_s", "cause"), [(3600.0, "stale"), (3600.125, "clock")])
def test_no_network_holds_a_message_back_for_more_than_an_hour(run: Run, old_s: float, cause: str) -> None:
    run.take(8.0, old_s=old_s)
    assert run.judge(8.0).cause == cause


def test_stale_says_whether_nothing_comes_or_whether_it_comes_late(run: Run) -> None:
    run.take(8.0, old_s=0.5)
    assert run.judge(8.5).reason == "stale: data comes late, it is 1.0 s old (limit 0.5 s)"
    assert run.judge(8.625).reason == "stale: no data for 0.6 s (limit 0.5 s), the process is there"
    broken = replace(THERE, undecodable="undecodable: not a map")
    assert run.judge(8.625, broken).reason == "undecodable: not a map"


def test_there_without_data_says_so_or_what_was_wrong_with_it(run: Run) -> None:
    assert run.judge(1.0).reason == "radar on pi0 is there, no data yet"
    starting = replace(THERE, status=status(1.0, "starting", "warming up"))
    assert run.judge(1.0, starting).reason == "radar on pi0 is there, no data yet (warming up)"
    broken = replace(THERE, undecodable="undecodable: not a map")
    assert run.judge(1.0, broken).reason == "undecodable: not a map"


def test_a_token_that_was_seen_and_went_is_a_process_that_ended(run: Run) -> None:
    assert run.judge(1.0, LinkState()).cause == "waiting"
    run.judge(1.125)
    health = run.judge(1.25, LinkState())
    assert health.cause == "service_gone"
    assert health.reason == "radar on pi0 has ended; the host is up"


def test_silence_for_longer_than_a_status_period_before_the_token_went_is_the_host(messages: Any) -> None:
    gone = LinkState(host_alive=False)
    at_the_limit, after_it = Run(messages).online(), Run(messages).online()
    assert at_the_limit.judge(9.625, gone).cause == "service_gone"
    assert after_it.judge(9.75, gone).cause == "host_unreachable"
    with_status = replace(gone, status=status(8.5, "online"))
    assert Run(messages).online().judge(10.0, with_status).cause == "service_gone", (
        "its status was heard later than its data"
    )


def test_nothing_heard_for_longer_than_a_status_period_is_a_process_that_hangs(run: Run) -> None:
    run.online()
    assert run.judge(9.625).cause == "stale"
    assert run.judge(9.75).cause == "not_answering"
    assert run.judge(9.75, replace(THERE, status=status(8.25, "online"))).cause == "stale"
    assert run.judge(9.75, replace(THERE, undecodable="undecodable: x")).reason == "undecodable: x"


def test_a_disconnected_sensor_has_no_level(run: Run) -> None:
    run.take(8.0, level="IMMINENT")
    run.take(8.125, level="IMMINENT")
    assert run.watch.judge(8.125, START_NS, THERE)[0].level == "IMMINENT"
    lost, _ = run.watch.judge(9.0, START_NS, THERE)
    assert (lost.state, lost.level, lost.age_s) == ("disconnected", None, 0.875)


def test_the_services_own_word_counts_as_long_as_it_is_fresh(run: Run) -> None:
    run.online()
    hot = replace(THERE, status=status(5.25, "degraded", "too hot"))
    assert run.judge(8.25, hot).reason == "too hot"  # exactly 3.0 s old
    run.take(8.375)
    run.take(8.5)
    assert run.judge(8.5, hot).state == "online"
    old_word = replace(THERE, status=status(8.5, "degraded", "too hot", old_s=3.125))
    assert run.judge(8.5, old_word).state == "online"
    nameless = replace(THERE, status=status(8.5, "degraded"))
    assert run.judge(8.5, nameless).reason == "degraded, no reason given"


def test_a_message_that_is_degraded_without_a_reason(run: Run) -> None:
    run.online()
    run.take(8.25, state="degraded")
    assert run.judge(8.25).reason == "degraded, no reason given"


@pytest.mark.parametrize(
    ("arrivals_s", "judged_s", "expected_hz"),
    [
        ((8.0,), 8.0, 0.0),
        ((8.0, 8.5), 8.5, 2.0),
        ((8.0, 8.5, 10.0), 10.0, 1.0),  # the first is exactly as old as the window
        ((8.0, 8.5, 10.0), 10.125, 2 / 3),  # now it is older
        ((8.0, 8.0005), 8.125, 1000.0),  # a burst
    ],
)
def test_the_rate(run: Run, arrivals_s: tuple[float, ...], judged_s: float, expected_hz: float) -> None:
    for at_s in arrivals_s:
        run.take(at_s)
    assert run.judge(judged_s).rate_hz == pytest.approx(expected_hz, rel=1e-9)


def test_the_age_is_told_in_tenths_of_a_millisecond(run: Run) -> None:
    run.take(8.0)
    assert run.judge(8.12346).age_ms == 123.5


def test_the_stages_of_an_age(run: Run) -> None:
    """Measured 100 ms ago (300 ms by a clock 200 ms behind ours), complete 20 ms and sent 50 ms after that."""
    around = replace(THERE, clock=SenderClock(-0.2))
    measured_ns = START_NS + 7_700_000_000
    for at_s in (8.0, 8.0078125):
        run.take(
            at_s,
            old_s=at_s - 7.7,
            around=around,
            received_ns=measured_ns + 20_000_000,
            sent_ns=measured_ns + 50_000_000,
        )
    seen, _ = run.watch.judge(8.0136289, START_NS, around)
    assert seen.stage_ms == pytest.approx({"capture": 20.0, "processing": 30.0, "transport": 57.813, "fusion": 5.816})
    assert seen.stage_ms["fusion"] == 5.816


def test_stages_that_no_stamp_tells_are_left_out(run: Run) -> None:
    run.take(8.0, received_ns=0, sent_ns=0)
    run.take(8.125, old_s=0.0625, received_ns=0, sent_ns=START_NS + 8_120_000_000)
    assert run.judge(8.125).state == "online"
    seen, _ = run.watch.judge(8.125, START_NS, THERE)
    assert set(seen.stage_ms) == {"processing", "transport", "fusion"}
    assert seen.stage_ms["processing"] == pytest.approx(57.5)  # from the measurement, when nobody says when it arrived


@pytest.mark.parametrize(("announced", "cause"), [(None, "two_claimants"), (False, "two_claimants"), (True, "")])
def test_numbers_that_go_back_are_another_sender_unless_one_takes_over(
    run: Run, announced: bool | None, cause: str
) -> None:
    around = THERE if announced is None else replace(THERE, handing_over=announced)
    for eighth in range(8):
        run._seq = 10 * (eighth % 2)  # new measurements, alternately under old and new numbers
        run.take(8.0 + 0.125 * eighth, around=around)
    assert run.judge(9.0, around).cause == cause


def test_a_stale_sensor_never_gives_a_time_within_its_limit_as_the_reason(run: Run) -> None:
    run.take(8.0, old_s=0.25)
    assert run.judge(8.5).reason == "stale: the last data is 0.75 s old (limit 0.5 s), the process is there"
