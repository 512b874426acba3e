"""`spotter health`: a health message that cannot be read is told, and hides neither verdict nor the command."""

from __future__ import annotations

import json
import threading
import time

import msgpack
import pytest
from typer.testing import CliRunner

from common.codec import encode
from common.config import ZenohConfig
from spotter_tools.cli.__main__ import app
from spotter_tools.cli.connect import bus

pytestmark = pytest.mark.patient


def test_an_unreadable_health_is_one_line_beside_the_verdict(zenoh_config: ZenohConfig, speakers: object) -> None:
    stop = threading.Event()
    endpoint = zenoh_config.connect[0]

    def speak() -> None:
        with bus(endpoint, "spotter") as session:
            while not stop.wait(0.02):
                session.put("jetson0/fusion/verdict", encode(speakers.verdict(time.time_ns())))  # type: ignore[attr-defined]
                session.put("jetson0/fusion/health", msgpack.packb({"clocks": {"pi0/radar": {"offset_ms": 1e30}}}))

    thread = threading.Thread(target=speak)
    thread.start()
    try:
        result = CliRunner().invoke(app, ["health", "--connect", endpoint])
    finally:
        stop.set()
        thread.join()
    assert result.exit_code == 0, result.output
    assert result.output.count("jetson0/fusion/health cannot be read") == 1
    assert "CAUTION -> SLOW" in result.output


def test_without_a_verdict_no_health_counts_for_programs_either(zenoh_config: ZenohConfig, speakers: object) -> None:
    stop, endpoint = threading.Event(), zenoh_config.connect[0]

    def speak() -> None:
        with bus(endpoint, "spotter") as session:
            while not stop.wait(0.02):
                session.put("jetson0/fusion/health", encode(speakers.health(time.time_ns())))  # type: ignore[attr-defined]

    thread = threading.Thread(target=speak)
    thread.start()
    try:
        result = CliRunner().invoke(app, ["health", "--json", "--connect", endpoint])
    finally:
        stop.set()
        thread.join()
    assert result.exit_code == 1
    assert json.loads(result.stdout.splitlines()[0]) == {"verdict": None, "health": None}


def test_the_verdicts_of_two_vehicles_are_never_mixed(zenoh_config: ZenohConfig, speakers: object) -> None:
    stop, endpoint = threading.Event(), zenoh_config.connect[0]
    levels = {"jetson0": "SAFE", "jetson1": "IMMINENT"}

    def speak() -> None:
        with bus(endpoint, "spotter") as session:
            while not stop.wait(0.02):
                for host, level in levels.items():
                    session.put(f"{host}/fusion/verdict", encode(speakers.verdict(time.time_ns(), level)))  # type: ignore[attr-defined]

    thread = threading.Thread(target=speak)
    thread.start()
    try:
        shown = {
            host: CliRunner().invoke(app, ["health", "--connect", endpoint, "--fusion-host", host]).output
            for host in (*levels, "*")
        }
    finally:
        stop.set()
        thread.join()
    assert ("SAFE -> GO" in shown["jetson0"], "IMMINENT" in shown["jetson0"]) == (True, False)
    assert ("IMMINENT -> STOP" in shown["jetson1"], "SAFE" in shown["jetson1"]) == (True, False)
    assert ("SAFE -> GO" in shown["*"]) != ("IMMINENT -> STOP" in shown["*"])
    assert "gives verdicts too" in shown["*"]
