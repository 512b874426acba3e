"""The drill's own parts: the plan file, the spoiled messages, the link that can be cut, and one real drill."""

from __future__ import annotations

import json
import math
import re
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import psutil
import pytest
from typer import Typer
from typer.testing import CliRunner

from common.clock import monotonic_s
from common.codec import DecodeError, decode, encode
from common.config import ConfigError
from common.messages import RadarTracks, SensorHealth, SystemHealth, Verdict, VerdictInput
from common.system_messages import VerdictClaim
from spotter_sim.world import scenario_named
from spotter_tools.cli import drill as command_line
from spotter_tools.drill.fault_plan import DEFAULT_FILE, Expected, Fault, load_plan
from spotter_tools.drill.link_proxy import LinkProxy
from spotter_tools.drill.monitor import broken_rules
from spotter_tools.drill.rig import SIM_WARM_UP_S, Rig
from spotter_tools.drill.run import Result, report_lines
from spotter_tools.drill.standin import STRANGER, FaultInjector


def injector(kind: str, seconds: float = 0.0) -> FaultInjector:
    one = FaultInjector("pi0")
    one.set(Fault(kind=kind, service="radar", seconds=seconds))  # type: ignore[arg-type]
    return one


def payload(seq: int = 0) -> bytes:
    return encode(
        RadarTracks(stamp_ns=10**18 + seq, seq=seq, tracks=[], level="SAFE", settled=True, noise_floor_db=-60.0)
    )


def test_without_a_fault_the_stand_in_passes_everything_on() -> None:
    assert FaultInjector("pi0").feed(5.0, b"abc") == [(5.0, "pi0", b"abc")]


def test_delay_duplicate_reorder_stuck_and_foreign_host() -> None:
    assert injector("delay", 2.0).feed(5.0, b"a") == [(7.0, "pi0", b"a")]
    assert [out[2] for out in injector("duplicate").feed(5.0, b"a")] == [b"a"] * 3
    pairs = injector("reorder")
    assert pairs.feed(5.0, b"a") == []
    assert [out[2] for out in pairs.feed(5.1, b"b")] == [b"b", b"a"]
    stuck = injector("stuck")
    assert [stuck.feed(now_s, p)[0][2] for now_s, p in ((5.0, b"a"), (5.1, b"b"))] == [b"a", b"a"]
    assert injector("foreign_host").feed(5.0, b"a") == [(5.0, STRANGER, b"a")]


@pytest.mark.parametrize("name", ["drive.toml", "emergency.toml"])
def test_the_plans_on_the_move_can_be_run(name: str) -> None:
    plan = load_plan(DEFAULT_FILE.with_name(name))
    assert plan.services == ("ego",)
    assert scenario_named(plan.scenario).vehicle is not None


def test_a_plan_with_an_unknown_service_is_refused(tmp_path: Path) -> None:
    text = DEFAULT_FILE.with_name("drive.toml").read_text().replace('"ego"', '"egg"')
    (tmp_path / "plan.toml").write_text(text)
    with pytest.raises(ConfigError, match="services: no service 'egg'"):
        load_plan(tmp_path / "plan.toml")


@pytest.mark.parametrize("kind", ["garbage", "wrong_types", "nan", "million"])
def test_wrong_data_is_refused_by_the_codec(kind: str) -> None:
    one = injector(kind)
    for seq in range(5):
        ((_, _, spoiled),) = one.feed(5.0, payload(seq))
        with pytest.raises(DecodeError):
            decode(spoiled, RadarTracks, max_bytes=1_000_000)


def test_stamps_and_sequence_numbers_are_moved() -> None:
    ((_, _, future),) = injector("future", 30.0).feed(5.0, payload())
    assert decode(future, RadarTracks).stamp_ns == 10**18 + 30 * 10**9
    ((_, _, past),) = injector("past", -30.0).feed(5.0, payload())
    assert decode(past, RadarTracks).stamp_ns == 10**18 - 30 * 10**9
    ((_, _, jump),) = injector("jump").feed(5.0, payload())
    assert decode(jump, RadarTracks).seq > 1000


def test_nan_reaches_nested_floats_only_where_they_are() -> None:
    ((_, _, spoiled),) = injector("nan").feed(5.0, payload())
    assert math.isnan(msgpack.unpackb(spoiled)["noise_floor_db"])


def test_the_shipped_plan_is_complete() -> None:
    plan = load_plan(DEFAULT_FILE)
    kinds = {fault.kind for drill in plan.drills for fault in drill.faults}
    assert {
        "kill",
        "freeze",
        "cut",
        "sim",
        "delay",
        "duplicate",
        "reorder",
        "clock",
        "garbage",
        "nan",
        "hang",
        "slow",
    } <= kinds
    assert len({drill.name for drill in plan.drills}) == len(plan.drills)
    for drill in plan.drills:
        for fault in drill.faults:
            if fault.kind == "kill":
                assert drill.health_within_s <= 0.2
            assert fault.kind != "sim" or fault.at_s >= SIM_WARM_UP_S


def test_every_process_and_the_router_are_drilled_to_the_actuator() -> None:
    drills = [drill for drill in load_plan(DEFAULT_FILE).drills if drill.actuator_within_s]
    assert {drill.actuator_within_s for drill in drills} == {0.3}
    alone = {(fault.kind, fault.service) for drill in drills for fault in drill.faults if len(drill.faults) == 1}
    assert alone == {(k, s) for k in ("kill", "freeze") for s in ("fusion", "gate", "router")} | {
        ("cut", "fusion"), ("cut", "gate"),
    }  # fmt: skip


def test_a_plan_can_be_narrowed_and_a_wrong_one_is_refused(tmp_path: Path) -> None:
    assert {"freeze"} == {f.kind for d in load_plan(DEFAULT_FILE, "FROZEN").drills for f in d.faults}
    with pytest.raises(ConfigError, match="no drill matches"):
        load_plan(DEFAULT_FILE, "volcano")
    text = DEFAULT_FILE.read_text()
    for wrong, error_text in (
        (text.replace('service = "radar"', 'service = "radr"'), "no service 'radr'"),
        (text.replace("health_within_s", "helth_within_s"), "helth_within_s"),
        (text.replace('kind = "kill"', 'kind = "maim"'), "maim"),
    ):
        file = tmp_path / "plan.toml"
        file.write_text(wrong)
        with pytest.raises(ConfigError, match=error_text):
            load_plan(file)


def verdict(level: Any, permission: Any = "STOP", **states: Any) -> Verdict:
    inputs = {
        name: VerdictInput(state=state, level=seen, age_ms=1.0, used=state == "online", why="x")
        for name, (state, seen) in states.items()
    }
    return Verdict(
        stamp_ns=1, level=level, rule="R0-clear", because="x", inputs=inputs, confirmed=False, suppressed=False,
        advisory=None, blind=False, permission=permission,
    )  # fmt: skip


ON, OUT = ("online", "SAFE"), ("disconnected", None)


def test_what_may_never_happen_is_found() -> None:
    assert broken_rules(verdict("SAFE", "GO", lidar=ON, radar=ON, camera=OUT)) == []
    assert broken_rules(verdict("SAFE", "GO", lidar=ON, radar=OUT, camera=OUT)) == ["SAFE while radar, camera are out"]
    assert broken_rules(verdict("CAUTION", "SLOW", lidar=OUT, radar=OUT, camera=OUT)) == ["blind without STOP"]
    lowered = verdict("CAUTION", "SLOW", lidar=("online", "IMMINENT"), radar=ON, camera=ON)
    assert broken_rules(lowered) == ["the lidar's IMMINENT was lowered to CAUTION"]


def test_expectations() -> None:
    radar = SensorHealth(state="disconnected", reason="x", since_ns=0, age_ms=None, rate_hz=0.0, cause="stale")
    health = SystemHealth(stamp_ns=1, sensors={"radar": radar}, colour="amber", summary="x", services={}, notes=["odd"])
    assert Expected(health={"radar": "disconnected"}, cause={"radar": "stale"}, note="od").health_fits(health)
    assert not Expected(cause={"radar": "service_gone"}).health_fits(health)
    assert not Expected(note="even").health_fits(health)
    assert not Expected(colour=("red",)).health_fits(health)
    one = verdict("SAFE", "GO", lidar=ON, radar=OUT, camera=ON)
    assert Expected(level=("SAFE",), unused=("radar",), health={"radar": "disconnected"}).verdict_fits(one)
    assert not Expected(health={"lidar": "degraded"}).verdict_fits(one)
    assert not Expected(unused=("lidar",)).verdict_fits(one)
    alarm = {"by": "lidar", "level": "IMMINENT", "what": "", "x_m": 0.4, "y_m": 0.0, "radius_m": 0.3, "since_ms": 9.0}
    for seen in (True, False):  # an alarm that is held counts although the sensor is out
        one.claims = [VerdictClaim(**alarm, seen=seen, seen_ms=3.0)]
        assert Expected(unused=("lidar",)).verdict_fits(one) is not seen
    assert not Expected(blind=True).verdict_fits(one)


def test_the_report_names_a_miss() -> None:
    results = [
        Result(name="good", ok=True, health_s=0.1, health_within_s=0.2, verdict_s=0.1, verdict_within_s=0.2),
        Result(name="bad", problems=["health: too late"]),
        Result(name="acts", ok=True, actuator_s=0.05, actuator_within_s=0.3),
        Result(name="elsewhere", ok=True, skipped="not possible against this system"),
    ]
    text = "\n".join(report_lines(results))
    assert "MISS: health: too late" in text
    assert "2 of 3 drills passed, 1 MISSED" in text
    assert "0.05 / 0.3 s" in text


def test_a_cut_link_carries_nothing_and_a_healed_one_everything() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        proxy = LinkProxy(("127.0.0.1", server.getsockname()[1]))
        address = ("127.0.0.1", int(proxy.endpoint.rpartition(":")[2]))
        with socket.create_connection(address) as client:
            far, _ = server.accept()
            with far:
                client.sendall(b"one")
                assert far.recv(3) == b"one"
                proxy.cut()
                client.sendall(b"two")
                far.settimeout(0.3)
                with pytest.raises(TimeoutError):
                    far.recv(3)
                proxy.heal()
                far.settimeout(5.0)
                assert far.recv(3) == b"two"
        proxy.close()


def test_a_slow_link_carries_everything_later_in_order_and_a_healed_one_at_once() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        proxy = LinkProxy(("127.0.0.1", server.getsockname()[1]))
        address = ("127.0.0.1", int(proxy.endpoint.rpartition(":")[2]))
        with socket.create_connection(address) as client:
            far, _ = server.accept()
            with far:
                proxy.slow(0.2)
                sent_s = monotonic_s()
                client.sendall(b"one")
                assert far.recv(3) == b"one"
                assert monotonic_s() - sent_s >= 0.2
                client.sendall(b"two")
                proxy.heal()
                far.settimeout(5.0)
                assert far.recv(3) == b"two"
                client.shutdown(socket.SHUT_WR)
                assert far.recv(3) == b"", "an end is carried too"
        proxy.close()


def test_the_command_lists_and_refuses() -> None:
    app = Typer()
    app.command()(command_line.drill)
    listed = CliRunner().invoke(app, ["--list"])
    assert listed.exit_code == 0
    assert "radar process killed" in listed.output
    assert CliRunner().invoke(app, ["--only", "volcano"]).exit_code == 2


@pytest.mark.slow
@pytest.mark.system
@pytest.mark.whole
def test_real_drills(tmp_path: Path) -> None:
    """A killed and a frozen process: real services over real Zenoh, with deadlines for a busy machine."""
    plan = tmp_path / "unhurried.toml"
    plan.write_text(re.sub(r"(health|verdict)_within_s = \S+", r"\1_within_s = 20.0", DEFAULT_FILE.read_text()))
    script = "import typer; from spotter_tools.cli.drill import drill; typer.run(drill)"
    command = [sys.executable, "-c", script, "--file", str(plan), "--only", "radar process", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=110)
    assert done.returncode == 0, done.stdout + done.stderr
    report = json.loads(done.stdout)
    assert [drill["ok"] for drill in report["drills"]] == [True, True]


def test_a_rig_of_which_one_cannot_start_leaves_nothing_behind(tmp_path: Path, free_ports: Callable[[], int]) -> None:
    before = set(psutil.Process().children())
    with (
        pytest.raises(KeyError, match="no_such_service"),
        Rig(free_ports(), "empty", tmp_path, ("lidar", "no_such_service")),
    ):
        pass
    assert (tmp_path / "lidar.log").exists()  # it was started
    assert set(psutil.Process().children()) <= before
