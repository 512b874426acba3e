"""Incidents: found alike on every host, kept whole, bounded, merged on one clock, decided again."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import zenoh

from common.bus.runtime import Service
from common.bus.session import open_session
from common.codec import encode
from common.config import ServiceConfig, ZenohConfig, load
from common.messages import ClockHealth, LidarZone, LidarZones, SensorHealth, SystemHealth, Verdict
from common.recording.reader import read, summarise
from common.topics import FUSION_HEALTH, FUSION_VERDICT, LIDAR_ZONES
from services.blackbox.capsule import incidents, keep_newest, merge, write_capsule
from services.blackbox.config import BlackboxConfig
from services.blackbox.pipeline import BlackboxPipeline
from services.blackbox.ring import Kept, Ring
from services.blackbox.source import keys_to_keep
from services.blackbox.trigger import NAME, Incident, Trigger, incident_name

SECOND = 1_000_000_000
T0 = 1_795_000_000 * SECOND
VERDICT_KEY, HEALTH_KEY = "jetson0/fusion/verdict", "jetson0/fusion/health"


def verdict(level: str, stamp_ns: int = T0, seq: int = 0) -> Verdict:
    return Verdict(
        stamp_ns=stamp_ns, seq=seq, level=level, rule="R1-worst-case", because="lidar sees", inputs={},  # type: ignore[arg-type]
        confirmed=False, suppressed=False, advisory=None, blind=False, permission="STOP",
    )  # fmt: skip


def health(state: str, stamp_ns: int = T0, clocks: dict[str, ClockHealth] | None = None) -> SystemHealth:
    sensor = SensorHealth(state=state, reason="why", since_ns=0, age_ms=1.0, rate_hz=10.0)  # type: ignore[arg-type]
    return SystemHealth(
        stamp_ns=stamp_ns, sensors={"lidar": sensor}, colour="green", summary="", services={}, clocks=clocks or {}
    )


def test_shipped_file_is_the_defaults() -> None:
    path = Path(__file__).parents[2] / "services" / "blackbox" / "blackbox.toml"
    assert load(BlackboxConfig, path) == BlackboxConfig()


@pytest.mark.parametrize(
    ("levels", "found"),
    [
        (["SAFE", "CAUTION"], ["CAUTION"]),
        (["SAFE", "CAUTION", "IMMINENT"], ["CAUTION", "IMMINENT"]),
        (["SAFE", "SAFE", "SAFE"], []),
        (["IMMINENT", "CAUTION", "SAFE"], []),  # coming down is none, and the first only tells how things are
        (["CAUTION", "SAFE", "IMMINENT"], ["IMMINENT"]),
    ],
)
def test_a_rise_is_an_incident(levels: list[str], found: list[str]) -> None:
    trigger = Trigger(BlackboxConfig())
    seen = [trigger.see(verdict(level)) for level in levels]
    assert [one.why.split()[0] for one in seen if one] == found


def test_a_changed_sensor_is_an_incident_unless_switched_off() -> None:
    trigger, quiet = Trigger(BlackboxConfig()), Trigger(BlackboxConfig(on_health_change=False))
    for state in ("online", "online", "degraded"):
        seen, silent = trigger.see(health(state)), quiet.see(health(state))
    assert seen is not None and seen.name.endswith("-lidar-degraded") and silent is None  # noqa: PT018


def test_a_sensor_that_comes_back_needs_no_reason() -> None:
    trigger = Trigger(BlackboxConfig())
    trigger.see(health("degraded"))
    back = health("online")
    back.sensors["lidar"].reason = ""
    seen = trigger.see(back)
    assert seen is not None
    assert seen.why == "lidar online"


def test_every_host_finds_the_same_name() -> None:
    names = set()
    for _ in range(3):
        trigger = Trigger(BlackboxConfig())
        trigger.see(verdict("SAFE"))
        incident = trigger.see(verdict("IMMINENT", T0 + 250_000_000))
        assert incident is not None
        names.add(incident.name)
    (name,) = names
    assert name.endswith(".250Z-imminent")
    assert NAME.match(name)


@pytest.mark.parametrize("what", ["../../etc/passwd", "", "A B/c", "x" * 500, "ümlaut"])
def test_names_are_always_harmless_folders(what: str) -> None:
    name = incident_name(T0, what)
    assert NAME.match(name)
    assert "/" not in name
    assert ".." not in name


def test_the_ring_is_bounded_in_time_and_bytes() -> None:
    ring = Ring(keep_s=5.0, max_bytes=1000)
    for i in range(100):
        ring.add(Kept("a/b/c", bytes(30), T0, i / 10))
    assert ring.size_bytes <= 1000
    assert ring.window(0.0, 100.0)[-1].at_s == 9.9
    ring.add(Kept("a/b/c", bytes(30), T0, 1000.0))
    assert ring.size_bytes == 30


@pytest.mark.parametrize("set_by_s", [0, -3600, 3600])
@pytest.mark.parametrize("set_at", [90, 105])
def test_the_window_around_each_trigger_is_kept_also_where_the_clock_is_set(set_by_s: int, set_at: int) -> None:
    pipeline = BlackboxPipeline(BlackboxConfig(before_s=3.0, after_s=2.0))
    saved = []
    for tenth in range(400):
        now_ns = T0 + tenth * SECOND // 10 + (set_by_s * SECOND if tenth >= set_at else 0)
        level = "IMMINENT" if 100 <= tenth < 110 or 300 <= tenth < 310 else "SAFE"
        kept = Kept(VERDICT_KEY, encode(verdict(level, now_ns, tenth)), now_ns, tenth / 10)
        saved += [one for one in [pipeline.process(tenth / 10, kept)] if one is not None]
    times_s = [[kept.at_s for kept in one.kept] for one in saved]
    assert [(min(times), max(times), len(times)) for times in times_s] == [(7.0, 12.0, 51), (27.0, 32.0, 51)]


def test_hostile_trigger_payloads_are_kept_but_trigger_nothing() -> None:
    pipeline = BlackboxPipeline(BlackboxConfig(before_s=1.0, after_s=0.5))
    for tenth in range(50):
        assert pipeline.process(tenth / 10, Kept(VERDICT_KEY, b"\xc1nonsense", T0, tenth / 10)) is None


def test_capsules_of_three_hosts_line_up_on_fusions_clock(tmp_path: Path) -> None:
    """pi0's clock is 80 ms ahead, infra0's 40 ms behind; what happened together is together when merged."""
    incident = Incident("20261119T010000.000Z-imminent", T0, "test")
    clocks = {
        "pi0/radar": ClockHealth(offset_ms=80.0, bound_ms=2.0, age_s=1.0, trusted=True),
        "infra0/infra_lidar": ClockHealth(offset_ms=-40.0, bound_ms=3.0, age_s=1.0, trusted=True),
    }
    ahead_ns = {"jetson0": 0, "pi0": 80_000_000, "infra0": -40_000_000}
    keys = {"jetson0": "jetson0/lidar/zones", "pi0": "pi0/lidar/zones", "infra0": "infra0/lidar/zones"}
    zone = LidarZone(nearest_m=None, points=0, level="SAFE")
    capsules = {}
    for host, offset_ns in ahead_ns.items():
        kept = [
            Kept(keys[host], encode(zones), T0 + i * SECOND + offset_ns, float(i))
            for i in range(5)
            for zones in [LidarZones(stamp_ns=i, left=zone, centre=zone, right=zone, level="SAFE", raw_level="SAFE")]
        ]
        shared = [Kept(VERDICT_KEY, encode(verdict("IMMINENT")), T0 + offset_ns, 0.0)]
        reports = [Kept(HEALTH_KEY, encode(health("online", clocks=clocks)), T0 + 1, 0.0)]
        own_health = reports if host == "jetson0" else []
        capsules[host] = write_capsule(
            tmp_path / host, host, incident, [*shared, *own_health, *kept], {"spotter": {"version": "x"}}
        )
    merged = tmp_path / "merged.mcap"
    applied = merge(capsules, "jetson0", merged)
    assert (applied["pi0"].offset_s, applied["pi0"].bound_s) == (0.08, 0.002)
    recorded = list(read(merged))
    assert sum(one.key == VERDICT_KEY for one in recorded) == 1  # what all hosts kept is kept once
    for i in range(5):
        together = [one.log_ns for one in recorded if one.key.endswith("zones")][3 * i : 3 * i + 3]
        assert max(together) - min(together) < 5_000_000
    assert [one.log_ns for one in recorded] == sorted(one.log_ns for one in recorded)


def test_a_host_whose_clock_is_unknown_is_merged_as_it_is(tmp_path: Path) -> None:
    incident = Incident("20261119T010000.000Z-imminent", T0, "test")
    kept = [Kept(VERDICT_KEY, encode(verdict("IMMINENT")), T0, 0.0)]
    capsules = {"pi0": write_capsule(tmp_path, "pi0", incident, kept, {})}
    applied = merge(capsules, "jetson0", tmp_path / "merged.mcap")
    assert applied["pi0"].offset_s is None
    assert summarise(tmp_path / "merged.mcap").counts == {VERDICT_KEY: 1}


def test_only_the_newest_incidents_stay(tmp_path: Path) -> None:
    for minute in range(5):
        incident = Incident(incident_name(T0 + minute * 60 * SECOND, "imminent"), T0, "test")
        write_capsule(tmp_path, "pi0", incident, [], {})
    (tmp_path / "somebody-elses-folder").mkdir()
    keep_newest(tmp_path, 2, ())
    assert incidents(tmp_path) == [incident_name(T0 + minute * 60 * SECOND, "imminent") for minute in (3, 4)]
    assert (tmp_path / "somebody-elses-folder").is_dir()


def test_what_was_written_last_stays_also_under_a_name_of_a_clock_that_was_set_back(tmp_path: Path) -> None:
    names = [incident_name(T0 + minute * 60 * SECOND, "imminent") for minute in (10, 11, 3, 2)]
    for number, name in enumerate(names):
        write_capsule(tmp_path, "pi0", Incident(name, T0, "test"), [], {})
        keep_newest(tmp_path, 2, names[2 : number + 1])  # the first two are of the process before
    assert incidents(tmp_path) == sorted(names[2:])


def test_an_unfinished_capsule_is_not_an_incident(tmp_path: Path) -> None:
    name = incident_name(T0, "imminent")
    (tmp_path / name).mkdir()
    (tmp_path / name / "pi0.part").write_bytes(b"half")
    incident = Incident(name, T0, "again")
    assert write_capsule(tmp_path, "pi0", incident, [], {}).name == "pi0.mcap"
    assert not (tmp_path / name / "pi0.part").exists()


def test_a_full_disk_leaves_nothing_of_a_capsule(tmp_path: Path, file_size_limit: Callable[[int], Any]) -> None:
    incident = Incident(incident_name(T0, "imminent"), T0, "test")
    with file_size_limit(10), pytest.raises(OSError, match="File too large"):
        write_capsule(tmp_path, "pi0", incident, [], {"spotter": {"note": "x" * 300_000}})
    assert list(tmp_path.iterdir()) == []


def test_own_topics_and_triggers_are_kept_large_ones_on_request() -> None:
    keys = keys_to_keep(BlackboxConfig(host="pi0"))
    assert {"pi0/radar/tracks", "pi0/*/status", VERDICT_KEY, HEALTH_KEY} <= set(keys)
    assert "pi0/camera/image" not in keys
    assert "pi0/camera/image" in keys_to_keep(BlackboxConfig(host="pi0", large=True))


def ask(session: zenoh.Session, key: str, **parameters: str) -> list[bytes]:
    replies = session.get(zenoh.Selector(key, zenoh.Parameters(parameters)), timeout=5)
    return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]


@pytest.mark.system
@pytest.mark.slow
def test_two_hosts_save_the_same_incident(
    zenoh_config: ZenohConfig, tmp_path: Path, spawn: Callable[..., Any], until: Callable[..., None]
) -> None:
    for host in ("jetson0", "pi0"):
        spawn(
            "spotter-blackbox", "--set", f"host={host}", "--set", f'zenoh.connect=["{zenoh_config.connect[0]}"]',
            "--set", f"folder={tmp_path / host}", "--set", "before_s=1.0", "--set", "after_s=0.5",
        )  # fmt: skip
    stop = threading.Event()
    levels = {"now": "SAFE"}
    zone = LidarZone(nearest_m=None, points=0, level="SAFE")

    def speak() -> None:
        with (
            Service("fusion", ServiceConfig(host="jetson0", zenoh=zenoh_config)) as fusion,
            Service("lidar", ServiceConfig(host="pi0", zenoh=zenoh_config)) as lidar,
        ):
            put_verdict, put_zones = fusion.publisher(FUSION_VERDICT), lidar.publisher(LIDAR_ZONES)
            put_health = fusion.publisher(FUSION_HEALTH)
            while not stop.wait(0.02):
                put_verdict(verdict(levels["now"], time.time_ns()))
                put_health(health("online", time.time_ns()))
                put_zones(
                    LidarZones(
                        stamp_ns=time.time_ns(), left=zone, centre=zone, right=zone, level="SAFE", raw_level="SAFE"
                    )
                )

    speaker = threading.Thread(target=speak)
    speaker.start()
    try:
        with open_session(zenoh_config) as laptop:
            until(lambda: len(ask(laptop, "*/blackbox/incidents")) == 2, budget_s=30)
            alarm_at_s = time.monotonic() + 1.5  # both have seen SAFE by then
            while time.monotonic() < alarm_at_s:
                stop.wait(0.05)
            levels["now"] = "IMMINENT"
            until(lambda: incidents(tmp_path / "jetson0") and incidents(tmp_path / "pi0"), budget_s=20)
    finally:
        stop.set()
        speaker.join()
    (name,) = incidents(tmp_path / "jetson0")
    assert incidents(tmp_path / "pi0") == [name]
    counts = summarise(tmp_path / "pi0" / name / "pi0.mcap").counts
    assert counts["pi0/lidar/zones"] > 20
    assert counts[VERDICT_KEY] > 20


def test_a_blackbox_with_nothing_to_save_is_alive(
    router_endpoint: str, tmp_path: Path, spawn: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It publishes nothing for hours; systemd would start it again every half minute, the container be unhealthy."""
    monkeypatch.setenv("SPOTTER_ALIVE", str(tmp_path / "alive"))
    connect = f'zenoh.connect=["{router_endpoint}"]'
    process = spawn("spotter-blackbox", "--set", connect, "--set", f"folder={tmp_path / 'incidents'}")
    beat, beats, pause = tmp_path / "alive" / "blackbox", set[int](), threading.Event()
    deadline_s = time.monotonic() + 60.0
    while len(beats) < 5:  # one a second; without the loop's own word they end after two
        assert time.monotonic() < deadline_s
        assert process.poll() is None
        beats |= {beat.stat().st_mtime_ns} if beat.exists() else set()
        pause.wait(0.05)
