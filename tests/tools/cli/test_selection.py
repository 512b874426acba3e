"""What a wildcard subscribes to, and what `echo` and `hz` say when nobody publishes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from common import topics
from spotter_tools.cli.selection import KNOWN, select

SPOTTER = str(Path(sys.executable).with_name("spotter"))
ON_DEMAND = [topic for topic in KNOWN if topic.on_demand]


def run(endpoint: str, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([SPOTTER, *words, "--connect", endpoint], capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("key", ["*/*/*", "**", "jetson0/**", "*/camera/*"])
def test_a_wildcard_switches_no_stream_on(key: str) -> None:
    selection = select(key)
    assert not set(selection.expressions) & {topic.any_host for topic in ON_DEMAND}
    assert not any("**" in expression or expression.endswith("*") for expression in selection.expressions)


def test_what_a_wildcard_leaves_out_is_said() -> None:
    assert set(select("*/*/*").left_out) == {topic.name for topic in ON_DEMAND}
    assert "camera/image" in select("*/camera/*").note
    assert select("*/fusion/verdict").note == ""


@pytest.mark.parametrize("topic", ON_DEMAND, ids=lambda topic: topic.name)
def test_a_topic_that_is_named_is_subscribed_to(topic: topics.Topic) -> None:
    assert select(topic.any_host).expressions == (topic.any_host,)


def test_a_wildcard_host_keeps_other_hosts_out() -> None:
    selection = select("jetson0/*/*")
    assert selection.includes("jetson0/lidar/zones")
    assert not selection.includes("pi0/radar/tracks")


@pytest.mark.parametrize("command", [("echo",), ("hz", "--seconds", "1")])
def test_nobody_publishes_it_and_the_nearest_key_is_named(speaking: str, command: tuple[str, ...]) -> None:
    done = run(speaking, *command, "jetson0/lidar/zone")
    assert done.returncode == 1
    assert (
        done.stderr.splitlines()[-1]
        == "spotter: nobody publishes jetson0/lidar/zone; did you mean jetson0/lidar/zones?"
    )


def test_an_empty_router_is_told_apart(router_endpoint: str) -> None:
    done = run(router_endpoint, "echo", "nope")
    assert (done.returncode, done.stderr) == (1, "spotter: nobody publishes nope: no service is alive on this router\n")


def test_a_wildcard_shows_what_is_published(speaking: str) -> None:
    done = run(speaking, "hz", "*/*/*", "--seconds", "1", "-n", "1", "--json")
    keys = {json.loads(line)["key"] for line in done.stdout.splitlines()}
    assert {"jetson0/fusion/verdict", "jetson0/lidar/zones", "pi0/radar/tracks"} <= keys
