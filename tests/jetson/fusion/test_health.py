"""Sensor states from tokens, ages and self-reports, in simulated time; the first broken link is named."""

from __future__ import annotations

import itertools
from typing import Any

import pytest

from common.bus.presence import successor
from common.messages import LinkFault
from common.topics import SENSOR_TOPICS


def test_a_sensor_that_never_appeared_is_disconnected_and_waited_for(new_bench: Any) -> None:
    bench = new_bench(sensors=tuple(name for name in SENSOR_TOPICS if name != "radar"))
    verdict = bench.run(2.0)
    assert bench.is_in("radar", "disconnected", "waiting")
    assert "pi0/radar" in bench.sensor("radar").reason
    assert any("waiting for pi0/radar" in note for note in bench.health.notes)
    assert (verdict.level, verdict.rule, verdict.permission) == ("CAUTION", "A25-starting", "STOP")

    bench.start("radar")
    bench.until(lambda: bench.verdict.permission == "GO", 0.6)
    assert bench.health.notes == []


def test_online_after_three_good_frames_and_not_before(new_bench: Any) -> None:
    bench = new_bench()
    frames = 0
    while not bench.health or not bench.is_in("radar", "online"):
        bench.tick()
        frames = bench.seq["radar"]
        assert bench.sensor("radar").state == ("online" if frames >= 3 else "disconnected")
    assert frames == 3


def test_a_sensor_that_comes_back_impaired_stays_disconnected_for_three_frames_too(bench: Any) -> None:
    bench.kill("lidar")
    bench.run(0.2)
    bench.extra["lidar"] = {"state": "degraded", "reason": "blocked"}
    bench.start("lidar")
    while not bench.is_in("lidar", "degraded", "impaired"):
        bench.tick()
        assert bench.is_in("lidar", "disconnected") == (bench.seq["lidar"] < 3)
    assert bench.seq["lidar"] == 3


def test_an_impaired_sensor_stays_impaired_until_it_has_recovered_and_its_alarm_counts(bench: Any) -> None:
    bench.extra["radar"] = {"state": "degraded", "reason": "saturated"}
    bench.run(0.3)
    bench.extra["radar"], bench.levels["radar"] = {}, "IMMINENT"
    bench.run(0.1)
    assert bench.is_in("radar", "degraded", "recovering")
    assert bench.sensor("radar").reason == "recovering, 1 of 3 good frames"
    assert bench.verdict.level == "IMMINENT"


@pytest.mark.parametrize("name", ["lidar", "radar", "camera", "infra_lidar"])
def test_a_killed_process_is_seen_at_once(bench: Any, name: str) -> None:
    bench.kill(name)
    bench.tick()
    assert bench.is_in(name, "disconnected", "service_gone")
    bench.start(name)
    bench.until(lambda: bench.is_in(name, "online"), 0.4)


@pytest.mark.parametrize(("name", "limit_s"), [("lidar", 0.5), ("radar", 0.5), ("camera", 1.0), ("infra_lidar", 0.5)])
def test_a_frozen_process_is_stale_at_the_topics_limit(bench: Any, name: str, limit_s: float) -> None:
    bench.silent.add(name)
    took_s = bench.until(lambda: bench.is_in(name, "disconnected"), limit_s + 0.1)
    assert took_s >= limit_s - 0.15
    assert bench.is_in(name, "disconnected", "stale")
    assert "the process is there" in bench.sensor(name).reason


def test_silence_first_and_then_the_token_means_the_host(bench: Any) -> None:
    bench.silent.add("radar")
    bench.run(2.0)
    bench.kill("radar")
    bench.tick()
    assert bench.is_in("radar", "disconnected", "host_unreachable")
    words = "radar on pi0 does not answer: network cut, host down, or its process hangs"
    assert bench.sensor("radar").reason == words


def test_a_hanging_process_does_not_answer_and_one_without_data_does(bench: Any) -> None:
    """SIGSTOP: no data, no status, and two seconds later the router takes the token away."""
    bench.silent.add("lidar")
    bench.run(0.6)
    assert bench.is_in("lidar", "disconnected", "stale")
    for _ in range(3):
        bench.status("lidar", "online")
        bench.run(1.0)
        assert bench.is_in("lidar", "disconnected", "stale"), "its status comes"
    bench.run(1.0)
    assert bench.is_in("lidar", "disconnected", "not_answering")
    assert "LiDAR on jetson0 does not answer: nothing was heard for" in bench.sensor("lidar").reason
    bench.kill("lidar")
    bench.tick()
    assert bench.is_in("lidar", "disconnected", "not_answering")
    assert bench.sensor("lidar").reason == "LiDAR on jetson0 does not answer: its process hangs; the host is up"
    bench.silent.clear()
    bench.start("lidar")
    bench.until(lambda: bench.is_in("lidar", "online"), 0.4)


def test_a_process_that_ends_after_its_device_was_lost_has_ended(bench: Any) -> None:
    bench.silent.add("lidar")
    for _ in range(3):
        bench.status("lidar", "disconnected", "unplugged")
        bench.run(1.0)
    bench.kill("lidar")
    bench.tick()
    assert bench.is_in("lidar", "disconnected", "service_gone")
    assert bench.sensor("lidar").reason == "LiDAR on jetson0 has ended; the host is up"


def test_a_host_with_other_processes_alive_is_reachable(bench: Any) -> None:
    bench.instances.add(("pi0", "router", "r1"))
    bench.silent.add("radar")
    bench.run(2.0)
    bench.kill("radar")
    bench.tick()
    assert bench.is_in("radar", "disconnected", "not_answering")
    assert "the host is up" in bench.sensor("radar").reason


@pytest.mark.parametrize(("cause", "why"), [("clock", "clock of pi0 is wrong"), ("certificate", "it has expired")])
def test_a_host_that_tls_keeps_out_is_not_called_gone(bench: Any, cause: str, why: str) -> None:
    bench.silent.add("radar")
    bench.run(2.0)
    bench.kill("radar")
    bench.link_faults["pi0"] = LinkFault(cause=cause, why=why)
    bench.run(0.5)
    assert bench.is_in("radar", "disconnected", cause)
    assert bench.sensor("radar").reason == why
    assert bench.health.services["pi0/radar"].reason == why
    assert bench.is_in("lidar", "online")
    bench.link_faults.clear()
    bench.start("radar")
    bench.silent.clear()
    bench.until(lambda: bench.is_in("radar", "online"), 1.0)


def test_a_lost_device_is_told_apart_and_comes_back(bench: Any) -> None:
    bench.silent.add("lidar")
    bench.status("lidar", "disconnected", "no device at /dev/ttyTHS1; plug it in")
    bench.tick()
    assert bench.is_in("lidar", "disconnected", "device_lost")
    assert bench.sensor("lidar").reason == "no device at /dev/ttyTHS1; plug it in"
    bench.silent.clear()
    bench.until(lambda: bench.is_in("lidar", "online"), 0.4)


def test_a_degraded_message_degrades_and_recovery_takes_three_frames(bench: Any) -> None:
    bench.extra["camera"] = {"state": "degraded", "reason": "too dark: brightness 23"}
    bench.until(lambda: bench.is_in("camera", "degraded", "impaired"), 0.1)
    assert bench.sensor("camera").reason == "too dark: brightness 23"
    assert bench.health.summary == "camera DEGRADED: no visual confirmation"
    bench.extra["camera"] = {}
    took_s = bench.until(lambda: bench.is_in("camera", "online"), 0.4)
    assert took_s >= 0.2


def test_a_status_alone_can_degrade(bench: Any) -> None:
    bench.status("radar", "degraded", "FIFO overflow")
    bench.tick()
    assert bench.is_in("radar", "degraded", "impaired")
    bench.run(4.0)
    assert bench.is_in("radar", "online"), "a status that is never renewed loses its say"


def test_a_radar_that_settles_casts_no_safe_vote(bench: Any) -> None:
    bench.extra["radar"] = {"settled": False}
    bench.until(lambda: bench.is_in("radar", "degraded", "impaired"), 0.1)
    assert "settling" in bench.sensor("radar").reason


def test_two_claimants_are_named_and_their_alarm_counts(bench: Any) -> None:
    bench.instances.add(("pi0", "radar", "second"))
    bench.levels["radar"] = "CAUTION"
    bench.run(0.2)
    assert bench.is_in("radar", "degraded", "two_claimants")
    assert bench.verdict.level == "CAUTION"
    assert "pi0/radar: 2 processes claim this name" in bench.health.notes


def test_an_announced_successor_is_no_second_claimant(bench: Any) -> None:
    bench.instances.add(("pi0", "radar", successor("second", "radar")))
    bench.run(0.3)
    assert bench.is_in("radar", "online")
    assert bench.health.services["pi0/radar"].instances == 1
    assert not any("claim" in note for note in bench.health.notes)


def test_a_watcher_that_lost_its_own_link_blames_nobody_else(bench: Any) -> None:
    bench.isolated = True
    bench.instances = set()
    bench.tick()
    assert bench.health.summary.startswith("I AM ISOLATED")
    assert {sensor.cause for sensor in bench.health.sensors.values()} == {"isolated"}
    assert (bench.verdict.level, bench.verdict.blind, bench.verdict.permission) == ("CAUTION", True, "STOP")


def test_every_other_host_gone_points_at_our_own_network(bench: Any) -> None:
    bench.instances = {one for one in bench.instances if one[0] == "jetson0"}
    bench.run(1.0)
    assert any("no other host is reachable" in note for note in bench.health.notes)


def test_a_sensor_at_the_edge_of_its_limit_does_not_flap(bench: Any) -> None:
    """One frame every 0.6 s: never three good ones in a row, so it goes out once and stays out."""
    bench.silent.add("radar")
    states = []
    for step in range(200):
        if step % 12 == 0:
            bench.receive(bench.key("radar"), bench.message("radar"))
        bench.tick()
        states.append(bench.sensor("radar").state)
    changes = [pair for pair in itertools.pairwise(states) if pair[0] != pair[1]]
    assert changes == [("online", "disconnected")]


def test_health_comes_on_change_and_at_least_twice_a_second(bench: Any) -> None:
    times_s = []
    for _ in range(40):
        before = bench.health
        bench.tick()
        if bench.health is not before:
            times_s.append(bench.now_s)
    gaps = [later - earlier for earlier, later in itertools.pairwise(times_s)]
    assert max(gaps) <= 0.5
    assert min(gaps) > 0.2, "nothing changed, so it is not told at every tick"


def test_rate_age_and_since_are_told(bench: Any) -> None:
    bench.run(3.0)
    sensor = bench.sensor("radar")
    assert sensor.rate_hz == pytest.approx(10.0, rel=0.1)
    assert sensor.age_ms is not None
    assert 0.0 < sensor.age_ms < 200.0
    since_ns = sensor.since_ns
    bench.run(1.0)
    assert bench.sensor("radar").since_ns == since_ns


def test_services_are_listed_with_what_they_say_of_themselves(bench: Any) -> None:
    bench.instances.add(("jetson0", "dashboard", "d1"))
    bench.status("radar", "online")
    bench.run(0.1)
    services = bench.health.services
    assert services["jetson0/dashboard"].alive
    assert (services["pi0/radar"].state, services["pi0/radar"].instances) == ("online", 1)
    bench.kill("radar")
    bench.tick()
    assert not bench.health.services["pi0/radar"].alive
