"""Fixtures for every test: where the recordings are, free ports, a router on loopback."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh
from hypothesis import HealthCheck, settings

from common.config import ZenohConfig
from common.session import build

REPOSITORY = Path(__file__).parent.parent

# A shared machine is slow now and then: examples are bounded by number, not by time.
settings.register_profile("spotter", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("spotter")

# Whoever asks for one of these runs real processes or real Zenoh: such tests want the machine for themselves, unless
# they say that they are patient.
LIVE_FIXTURES = frozenset({
    "router_endpoint", "zenoh_config", "module_router", "browser", "start_dashboard_at", "spawn",
    "running_demo", "demo_json", "yard", "speaking",
})  # fmt: skip


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark them, before ``-m`` selects; files with slow tests come first, so that workers end together."""
    for item in items:
        live = isinstance(item, pytest.Function) and not LIVE_FIXTURES.isdisjoint(item.fixturenames)
        if live and item.get_closest_marker("patient") is None:
            item.add_marker("system")
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture(scope="session")
def recordings() -> Callable[[str], Path]:
    """``recordings("ld06")`` is the folder of a real recording; the test is skipped where it is absent."""
    root = Path(os.environ.get("SPOTTER_DATA", REPOSITORY.parent / "shared" / "data"))

    def folder(name: str) -> Path:
        path = root / name
        if not path.exists():
            pytest.skip(f"real recording {name!r} is not here; set SPOTTER_DATA to the folder that holds it")
        return path

    return folder


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def free_ports() -> Callable[[], int]:
    """Each call gives a TCP port that was free a moment ago."""
    return free_port


@pytest.fixture
def router_endpoint() -> Iterator[str]:
    """A Zenoh router in this process, on loopback and a free port, scouting off."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with zenoh.open(build(ZenohConfig(mode="router", connect=(), listen=(endpoint,), namespace=""))):
        yield endpoint


@pytest.fixture
def zenoh_config(router_endpoint: str) -> ZenohConfig:
    """How a service under test reaches that router."""
    return ZenohConfig(connect=(router_endpoint,))
