"""What Prometheus scrapes from a small real system."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Callable
from pathlib import Path

import pytest

from spotter_tools.cli.connect import bus
from spotter_tools.cli.system_view import Observer

pytest.importorskip("prometheus_client")

Until = Callable[[Callable[[], object]], None]


def scrape(observer: Observer) -> dict[str, float]:
    from prometheus_client import CollectorRegistry, generate_latest

    from spotter_tools.cli.metrics import Collector

    registry = CollectorRegistry()
    registry.register(Collector(observer))
    return parse(generate_latest(registry).decode())


def parse(text: str) -> dict[str, float]:
    lines = [line.rsplit(" ", 1) for line in text.splitlines() if line and not line.startswith("#")]
    return {name: float(value) for name, value in lines}


def test_figures_are_those_of_the_system(speaking: str, until: Until) -> None:
    with bus(speaking, "spotter") as session:
        observer = Observer(session)
        until(lambda: observer.complete() and len(observer.overview().services) == 3)
        until(lambda: all(one.cpu_share is not None for one in observer.overview().services))
        until(lambda: observer.overview().fusions[0].sensors["lidar"].latency_p99_ms is not None)
        figures = scrape(observer)
        observer.close()
    radar = '{host="pi0",service="radar"}'
    assert figures[f"spotter_service_up{radar}"] == 1
    assert figures[f"spotter_service_published_total{radar}"] > 0
    assert figures[f"spotter_service_memory_bytes{radar}"] > 1e7
    assert figures['spotter_service_state{host="pi0",service="radar",state="online"}'] == 1
    assert figures['spotter_service_state{host="pi0",service="radar",state="degraded"}'] == 0
    assert figures['spotter_verdict_level{host="jetson0"}'] == 1
    assert figures['spotter_sensor_state{host="jetson0",sensor="lidar",state="online"}'] == 1
    assert 0 < figures['spotter_latency_seconds{host="jetson0",quantile="0.99",sensor="lidar"}'] < 5
    assert figures['spotter_topic_rate_hertz{key="pi0/radar/tracks"}'] > 5
    assert figures['spotter_topic_age_limit_seconds{key="pi0/radar/tracks"}'] == 0.5


def test_no_verdict_is_minus_one_and_blind(router_endpoint: str) -> None:
    with bus(router_endpoint, "spotter") as session:
        observer = Observer(session)
        figures = scrape(observer)
        observer.close()
    assert (figures['spotter_verdict_level{host=""}'], figures['spotter_verdict_blind{host=""}']) == (-1, 1)


@pytest.mark.system
def test_the_command_serves_until_it_is_stopped(speaking: str) -> None:
    script = str(Path(sys.executable).with_name("spotter"))
    command = [script, "metrics", "--port", "0", "--connect", speaking, "--host", "pi0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        url = re.search(r"http://\S+", process.stderr.readline())
        assert url is not None
        with urllib.request.urlopen(url[0], timeout=10) as reply:
            assert 'spotter_verdict_level{host=""}' in parse(reply.read().decode())
        process.send_signal(signal.SIGTERM)
        assert process.wait(10) == 0
