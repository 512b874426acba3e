"""A word that is repeated is as old as its stamp says: the vehicle's motion and the services' statuses."""

from __future__ import annotations

from typing import Any

import pytest

from common.messages import EgoMotion
from services.jetson.fusion.clocks import ClockSample
from services.jetson.fusion.config import FusionConfig


def moves(bench: Any, speed_mps: float | None, *, old_s: float = 0.0, seq: int = 0) -> None:
    """An EgoMotion that was measured ``old_s`` ago by our own clock arrives."""
    motion = EgoMotion(stamp_ns=bench.now_ns - round(old_s * 1e9), seq=seq, speed_mps=speed_mps, yaw_rate_radps=0.0)
    bench.receive("jetson0/ego/motion", motion)


def static_track_counts(bench: Any) -> bool:
    """R9: with the LiDAR degraded, standing radar tracks count unless the vehicle is known to stand."""
    return bool(bench.verdict.rule == "R9-static-radar")


@pytest.fixture
def half_blind(new_bench: Any) -> Any:
    """The LiDAR is degraded, and the radar has a standing track near by."""
    bench = new_bench()
    bench.run(1.0)
    bench.extra["lidar"] = {"state": "degraded", "reason": "blocked"}
    bench.extra["radar"] = {"static_level": "IMMINENT"}
    bench.run(0.5)
    assert static_track_counts(bench)
    return bench


def test_a_motion_of_now_that_says_standing_ends_the_fallback(half_blind: Any) -> None:
    for seq in range(4):
        moves(half_blind, 0.0, seq=seq)
        half_blind.tick()
    assert not static_track_counts(half_blind)
    half_blind.run(1.0)
    assert static_track_counts(half_blind), "nothing came for longer than its limit"


@pytest.mark.parametrize("old_s", [3600.0, 0.6, -0.2])
@pytest.mark.parametrize("counts", [True, False])
def test_a_motion_of_an_hour_ago_that_is_sent_again_and_again_is_no_motion(
    half_blind: Any, old_s: float, counts: bool
) -> None:
    for seq in range(40):
        moves(half_blind, 0.0, old_s=old_s, seq=seq if counts else 0)
        half_blind.tick()
        assert static_track_counts(half_blind)


def test_one_motion_that_is_sent_again_and_again_ages(half_blind: Any) -> None:
    moves(half_blind, 0.0)
    (sent,) = half_blind.pending
    half_blind.run(0.5)
    assert not static_track_counts(half_blind)
    for _ in range(20):
        half_blind.receive(sent.key, sent.message)
        half_blind.tick()
    assert static_track_counts(half_blind)
    assert half_blind.pipeline.bad_input["jetson0/ego/motion: repeated"] >= 10


def test_the_offset_of_the_ego_services_clock_counts(new_bench: Any) -> None:
    """Its clock is an hour behind ours and measured: what it stamps now is of now."""
    bench = new_bench(FusionConfig())
    inbox = bench.pipeline._inbox
    inbox.roster.services["jetson0/ego"] = ("e",)
    inbox._clock_of["jetson0/ego"].add(ClockSample("jetson0/ego", bench.now_s, -3600.0, 0.001))
    motion = EgoMotion(stamp_ns=bench.now_ns - 3600 * 10**9, speed_mps=0.0, yaw_rate_radps=0.0)
    bench.receive("jetson0/ego/motion", motion)
    (received,) = bench.pending
    inbox.ego.take(received, inbox._clock_of["jetson0/ego"].sender(bench.now_s))
    assert inbox.ego.now(bench.now_s + 0.4).moving is False
    assert inbox.ego.now(bench.now_s + 0.6).moving is None


def test_a_repeated_status_says_nothing_new(bench: Any) -> None:
    """A word of the radar, sent again for ever by somebody: it counts for its three seconds."""
    bench.status("radar", "degraded", "too hot")
    (sent,) = bench.pending
    for _ in range(50):
        bench.receive(sent.key, sent.message)
        bench.tick()
    assert bench.is_in("radar", "degraded", "impaired")
    for _ in range(40):
        bench.receive(sent.key, sent.message)
        bench.tick()
    assert bench.is_in("radar", "online")
    assert bench.pipeline.bad_input["pi0/radar/status: repeated"] >= 80


def test_an_older_status_is_not_the_newest_and_two_of_one_moment_are_two(bench: Any) -> None:
    bench.status("radar", "degraded", "too hot")
    older = bench.pending.pop()
    bench.run(0.1)
    bench.status("radar", "degraded", "now")
    bench.status("radar", "online")
    bench.tick()
    assert bench.is_in("radar", "online")
    bench.receive(older.key, older.message)
    bench.run(0.2)
    assert bench.is_in("radar", "online")
    assert bench.pipeline.bad_input == {"pi0/radar/status: repeated": 1}


def test_a_status_of_an_hour_ago_is_no_status(bench: Any) -> None:
    bench.status("radar", "degraded", "too hot")
    (sent,) = bench.pending
    sent.message.stamp_ns -= 3600 * 10**9
    bench.run(0.5)
    assert bench.is_in("radar", "online")
    assert bench.health.services["pi0/radar"].state == "starting"


def test_of_a_host_whose_clock_nobody_knows_a_status_counts_from_its_arrival(bench: Any) -> None:
    """A box without a battery in its clock, and no sensor on it whose clock is measured."""
    bench.instances.add(("box9", "blackbox", "b"))
    bench.status("radar", "online")
    sent = bench.pending.pop()
    sent.message.stamp_ns = 1
    bench.receive("box9/blackbox/status", sent.message)
    bench.run(1.0)
    assert bench.health.services["box9/blackbox"].state == "online"


@pytest.mark.parametrize(("reason", "shown"), [("ended: drive.mcap, 12 MB", False), ("drive.mcap, 12 MB", True)])
def test_a_recorder_that_was_stopped_is_not_missed(bench: Any, reason: str, shown: bool) -> None:
    recorder = ("laptop", "recorder", "r")
    bench.instances.add(recorder)
    bench.status("radar", "online", reason)
    bench.receive("laptop/recorder/status", bench.pending.pop().message)
    bench.run(1.0)
    assert bench.health.services["laptop/recorder"].alive
    bench.instances.discard(recorder)
    bench.run(5.0)
    assert ("laptop/recorder" in bench.health.services) is shown
