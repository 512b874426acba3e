"""Fixtures for every test: where the recordings are, free ports, a router on loopback."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh
from _pytest.runner import runtestprotocol
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
    """Mark them, before ``-m`` selects."""
    for item in items:
        live = isinstance(item, pytest.Function) and not LIVE_FIXTURES.isdisjoint(item.fixturenames)
        if live and item.get_closest_marker("patient") is None:
            item.add_marker("system")


TRIES, TAKEN_S = 3, 0.3
_repeated = pytest.StashKey[list[str]]()


def taken_s(stat: str = "/proc/stat") -> float:
    """Seconds that a hypervisor ran others on this machine's processors since it came up ("steal" in proc(5))."""
    try:
        words = Path(stat).read_text().split()
    except OSError:
        return 0.0
    return int(words[8]) / os.sysconf("SC_CLK_TCK") if len(words) > 8 else 0.0


def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Half a second is a deadline to real processes, and means nothing where the machine itself stood still for as
    long: what fails while others ran on its processors is tried once more, and the summary says so."""
    if item.get_closest_marker("system") is None:
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for left in range(TRIES - 1, -1, -1):
        before_s = taken_s()
        reports = runtestprotocol(item, log=False, nextitem=nextitem)
        lost_s = taken_s() - before_s
        missed = any(report.failed and report.when == "call" for report in reports)
        if not missed or left == 0 or lost_s < TAKEN_S:
            break
        note = f"{item.nodeid}: failed while others had the processors for {lost_s:.1f} s; tried again"
        item.config.stash.setdefault(_repeated, []).append(note)
        item._initrequest()  # type: ignore[attr-defined]
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    for note in config.stash.get(_repeated, []):
        terminalreporter.write_line(f"REPEATED {note}")


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
