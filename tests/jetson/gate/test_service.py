"""The gate as a process over real Zenoh: a speaking fusion in this process, an actuator behind a pseudo-terminal."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh

from common.bus.runtime import Service
from common.bus.session import build
from common.clock import monotonic_s, utc_ns
from common.codec import decode, encode, encoding_of
from common.config import ServiceConfig, ZenohConfig
from common.messages import GateState, Verdict
from common.topics import COMMANDS, FUSION_VERDICT, GATE_STATE, Command
from services.jetson.gate.emulator import EmulatedActuator

Until = Callable[..., None]


def verdict(permission: Any = "GO", **changes: Any) -> Verdict:
    values: dict[str, Any] = {
        "stamp_ns": utc_ns(), "level": "SAFE", "rule": "R0-clear", "because": "clear", "inputs": {},
        "confirmed": False, "suppressed": False, "advisory": None, "blind": False, "permission": permission,
        "source_kind": "live",
    }  # fmt: skip
    return Verdict(**{**values, **changes})


class Fusion:
    """Speaks as fusion 25 times a second until it is silenced."""

    def __init__(self, zenoh_config: ZenohConfig, key: str = "") -> None:
        self.permission, self.kind, self.silent = "GO", "live", False
        self._service = Service("fusion", ServiceConfig(host="jetson0", zenoh=zenoh_config)).__enter__()
        self._publish = self._service.publisher(FUSION_VERDICT)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(0.04):
            if not self.silent:
                self._publish(verdict(self.permission, source_kind=self.kind))

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._service.__exit__(None, None, None)


class Bench:
    """Gate, actuator, and what the bus says."""

    def __init__(self, zenoh_config: ZenohConfig, actuator: EmulatedActuator, until: Until, *settings: str) -> None:
        self.zenoh_config, self.actuator, self.until = zenoh_config, actuator, until
        self.session = zenoh.open(build(zenoh_config))
        self.states: list[GateState] = []
        self._subscriber = self.session.declare_subscriber(
            GATE_STATE.key("jetson0"), lambda s: self.states.append(decode(s.payload.to_bytes(), GateState))
        )
        texts = (
            f'outputs=["serial:{actuator.device}"]',
            f"zenoh.connect={json.dumps(list(zenoh_config.connect))}",
            "release.after_stop_s=0.3",
            *settings,
        )
        options = [word for text in texts for word in ("--set", text)]
        self.process = subprocess.Popen([sys.executable, "-m", "services.jetson.gate", *options])

    def says(self, permission: str, cause: str = "") -> None:
        def fits() -> bool:
            newest = self.states[-1] if self.states else None
            return newest is not None and newest.permission == permission and cause in ("", newest.cause)

        last = lambda: self.states[-1] if self.states else "nothing"  # noqa: E731
        self.until(fits, f"{permission} {cause}, the gate says {last()}")
        self.until(lambda: self.actuator.permission == permission, f"the actuator does {permission}")

    def close(self) -> None:
        self.process.send_signal(signal.SIGCONT)
        self.process.terminate()
        self.process.wait(10.0)
        self.session.close()


@pytest.fixture
def bench(zenoh_config: ZenohConfig, until: Until) -> Iterator[Bench]:
    with EmulatedActuator() as actuator:
        one = Bench(zenoh_config, actuator, until)
        yield one
        one.close()


@pytest.fixture
def fusion(zenoh_config: ZenohConfig) -> Iterator[Fusion]:
    one = Fusion(zenoh_config)
    yield one
    one.close()


def test_from_fusions_word_to_the_actuator_and_back(bench: Bench, fusion: Fusion) -> None:
    bench.says("GO")
    assert bench.actuator.receiver.limit_mm_s == 5000
    fusion.permission = "SLOW"
    bench.says("SLOW")
    assert bench.actuator.receiver.limit_mm_s == 500
    fusion.permission = "STOP"
    bench.says("STOP", "verdict")
    fusion.permission = "GO"
    bench.says("GO")
    fusion.silent = True
    bench.says("STOP", "stale")
    fusion.silent, fusion.kind = False, "simulated"
    bench.says("STOP", "not_live")
    state = bench.states[-1]
    assert state.because == "the verdict rests on simulated data; accepted: live"
    assert list(state.outputs.values()) == ["STOP (as told)"]


def test_another_version_stops(bench: Bench, fusion: Fusion) -> None:
    bench.says("GO")
    fusion.silent = True
    publisher = bench.session.declare_publisher(
        "jetson0/fusion/verdict", encoding="application/msgpack;spotter.Verdict.v2"
    )
    publisher.put(encode(verdict()))
    bench.says("STOP", "unreadable")
    fusion.silent = False
    bench.says("GO")


def test_the_gate_frozen_and_killed(bench: Bench, fusion: Fusion, until: Until) -> None:
    bench.says("GO")
    os.kill(bench.process.pid, signal.SIGSTOP)
    until(lambda: bench.actuator.permission == "STOP", "a frozen gate is STOP")
    os.kill(bench.process.pid, signal.SIGCONT)
    bench.says("GO")
    assert "overrun" in {state.cause for state in bench.states}
    bench.process.kill()
    until(lambda: bench.actuator.permission == "STOP", "a dead gate is STOP")


def test_nobody_but_fusion_moves_it(bench: Bench, until: Until) -> None:
    """Without fusion's token; from the shadow; out of a replay: the gate has not even heard of it."""
    bench.says("STOP", "fusion_gone")
    replayed = ZenohConfig(connect=bench.zenoh_config.connect, namespace="replay")
    with zenoh.open(build(replayed)) as replay:
        for i in range(40):
            for session, key in ((bench.session, "shadow/jetson0/fusion/verdict"), (replay, "jetson0/fusion/verdict")):
                session.put(key, encode(verdict(seq=i)), encoding=encoding_of(Verdict))
        until(lambda: len(bench.states) > 5, "the gate goes on")
        assert {state.verdict_seq for state in bench.states} == {None}
        bench.session.put("jetson0/fusion/verdict", encode(verdict(seq=41)), encoding=encoding_of(Verdict))
        until(lambda: bench.states[-1].verdict_seq == 41, "it is heard")
        bench.says("STOP", "fusion_gone")
    assert {state.permission for state in bench.states} == {"STOP"}
    assert {change.permission for change in bench.actuator.changes} <= {"STOP"}


def test_a_second_sender_on_the_same_key_stops(bench: Bench, fusion: Fusion, until: Until) -> None:
    bench.says("GO")
    fusion.permission = "SLOW"
    bench.says("SLOW")
    publisher = bench.session.declare_publisher("jetson0/fusion/verdict", encoding=encoding_of(Verdict))
    publisher.put(encode(verdict("GO", seq=10**6)))
    bench.says("STOP", "two_senders")


def test_a_person_acknowledges(zenoh_config: ZenohConfig, fusion: Fusion, until: Until) -> None:
    assert Command("gate", "acknowledge", from_afar=False) in COMMANDS
    with EmulatedActuator() as actuator:
        bench = Bench(zenoh_config, actuator, until, "release.acknowledge=after_stop")
        try:
            bench.says("STOP", "acknowledge")
            (reply,) = bench.session.get("jetson0/gate/acknowledge", timeout=5.0)
            assert json.loads(reply.ok.payload.to_bytes())["counts"] is True
            bench.says("GO")
            fusion.permission = "STOP"
            bench.says("STOP", "verdict")
            fusion.permission = "GO"
            bench.says("STOP", "acknowledge")
            actuator.presses += 1
            bench.says("GO")
        finally:
            bench.close()


def test_the_end_is_a_stop(bench: Bench, fusion: Fusion, until: Until) -> None:
    bench.says("GO")
    told_s = monotonic_s()
    bench.process.terminate()
    assert bench.process.wait(10.0) == 0
    until(lambda: actuator_stopped_as_told(bench, told_s), "STOP was said, not only left out")


def actuator_stopped_as_told(bench: Bench, since_s: float) -> bool:
    return any(c.at_s >= since_s and (c.permission, c.why) == ("STOP", 0) for c in bench.actuator.changes)


def test_a_shadow_is_refused(zenoh_config: ZenohConfig) -> None:
    command = [sys.executable, "-m", "services.jetson.gate"]
    done = subprocess.run(command, env={**os.environ, "SPOTTER_SHADOW": "shadow"}, capture_output=True, text=True)
    assert (done.returncode, "never runs in the shadow" in done.stderr) == (2, True)
