"""Fixtures for every test: where the recordings are, free ports, a router on loopback, a site with certificates."""

from __future__ import annotations

import os
import re
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import cache
from pathlib import Path

import pytest
import zenoh
from hypothesis import HealthCheck, settings

from common.bus.session import build, close_session, open_session
from common.bus.status import Report
from common.config import ZenohConfig
from common.host.site import HostConfig, ServicePlace, Site
from common.security import authority
from common.security.router_config import laptop_config, router_config, with_certificate
from spotter_tools.ports import free_port

REPOSITORY = Path(__file__).parent.parent
BUDGET_S = 60.0
HOSTS = {
    "pi0": ("radar", "blackbox"),
    "jetson0": ("lidar", "camera", "fusion", "gate"),
    "infra0": ("infra_lidar",),
}

# What a shell starts in the background ignores Ctrl-C, and so would all programs that the tests start and interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A shared machine is slow now and then: examples are bounded by number, not by time.
settings.register_profile("spotter", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("spotter")

# A test with one of these fixtures runs real processes or real Zenoh. Such tests run four at a time at most
# (marked `system` here), unless they are marked as patient.
LIVE_FIXTURES = frozenset({
    "router_endpoint", "zenoh_config", "module_router", "browser", "start_dashboard_at", "spawn",
    "running_demo", "demo_json", "yard", "speaking",
})  # fmt: skip


LIVE_MARKS = ("system", "netns", "whole")
LIVE_WORDS = re.compile("|".join([rf"mark\.({'|'.join(LIVE_MARKS)})", *LIVE_FIXTURES]))


@cache
def names_live_tests(file: Path) -> bool:
    """Whether a file mentions one of the marks or fixtures."""
    return LIVE_WORDS.search(file.read_text()) is not None


def pytest_addoption(parser: pytest.Parser) -> None:
    """``--live-files``: to import all files, only to leave out most of their tests, takes every worker 15 s."""
    parser.addoption("--live-files", action="store_true", help="only files that name marks or fixtures of live tests")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """True: leave it out; None: others may decide."""
    is_test = collection_path.name.startswith("test_") and collection_path.suffix == ".py"
    left_out = is_test and config.getoption("--live-files") and not names_live_tests(collection_path)
    return True if left_out else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark them, before ``-m`` selects; files with slow tests come first, so that workers end together."""
    for item in items:
        live = isinstance(item, pytest.Function) and not LIVE_FIXTURES.isdisjoint(item.fixturenames)
        if live and item.get_closest_marker("patient") is None:
            item.add_marker("system")
        if any(map(item.get_closest_marker, LIVE_MARKS)) and not names_live_tests(item.path):
            raise pytest.UsageError(f"{item.nodeid} is live, but its file names none of {LIVE_WORDS.pattern}")
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


@pytest.fixture
def file_size_limit() -> Callable[[int], AbstractContextManager[None]]:
    """``with file_size_limit(10):`` no file of this process grows beyond 10 bytes, as on a full disk."""

    @contextmanager
    def limit(size: int) -> Iterator[None]:
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    return limit


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


def make_site(free: Callable[[], int], **services: tuple[str, ...]) -> Site:
    """Hosts with these services, on loopback and free ports."""
    hosts = {
        host: HostConfig(local_port=free(), port=free(), services={name: ServicePlace() for name in names})
        for host, names in services.items()
    }
    return Site(hosts=hosts, accept_simulated=True)


@pytest.fixture
def site(free_ports: Callable[[], int]) -> Site:
    return make_site(
        free_ports,
        pi0=("radar",),
        jetson0=("lidar", "camera", "fusion", "dashboard"),
        infra0=("infra_lidar",),
    )


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Certificates of pi0, jetson0, infra0 and laptop1."""
    folder = tmp_path_factory.mktemp("site") / "keys"
    authority.init(folder, "spotter")
    for host in ("pi0", "jetson0", "infra0"):
        authority.issue(folder, host, "host", ("127.0.0.1",))
    authority.issue(folder, "laptop1", "laptop")
    return folder


def _until(condition: Callable[[], object], what: str = "the condition", *, budget_s: float = BUDGET_S) -> None:
    deadline_s, pause = time.monotonic() + budget_s, threading.Event()
    while not condition():
        assert time.monotonic() < deadline_s, f"not within {budget_s:g} s: {what}"
        pause.wait(0.005)


@pytest.fixture(scope="session")
def until() -> Callable[..., None]:
    """``until(condition, what)`` polls until the condition is true and fails when the budget (60 s) is over."""
    return _until


@pytest.fixture
def spawn() -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    """``spawn("spotter-lidar", "--set", ...)`` starts a console script that ends with the test; stdout is a pipe."""
    started: list[subprocess.Popen[bytes]] = []

    def start(script: str, *arguments: object) -> subprocess.Popen[bytes]:
        command = [str(Path(sys.executable).with_name(script)), *map(str, arguments)]
        started.append(subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL))
        return started[-1]

    yield start
    for process in started:
        process.terminate()
        process.communicate(timeout=20)


@pytest.fixture
def report() -> Report:
    """What a service would tell of itself."""
    return Report("test")


class Yard:
    """Three routers with rules and links, a client on each loopback, and what jetson0's client hears."""

    def __init__(self, site: Site, keys: Path) -> None:
        self.site, self.keys = site, keys
        self.routers = {host: zenoh.open(build(router_config(site, host, keys))) for host in site.hosts}
        self.clients = {host: self.client(host) for host in site.hosts}
        self.received: list[tuple[str, bytes]] = []
        self.tokens: set[str] = set()
        listener = self.client("jetson0")
        self._kept = [
            listener,
            listener.declare_subscriber("**", lambda s: self.received.append((str(s.key_expr), s.payload.to_bytes()))),
            listener.liveliness().declare_subscriber("**", lambda s: self.tokens.add(str(s.key_expr)), history=True),
        ]

    def client(self, host: str) -> zenoh.Session:
        config = ZenohConfig(namespace=self.site.namespace, connect=(self.site.host(host).loopback,))
        return open_session(config, give_up_after_s=BUDGET_S)

    def laptop(self, host: str = "jetson0") -> zenoh.Session:
        return open_session(laptop_config(self.site, "laptop1", self.keys, host), give_up_after_s=BUDGET_S)

    def named(self, name: str, keys: Path | None = None, host: str = "jetson0") -> ZenohConfig:
        """A client of ``host``'s router, from outside, under any certificate."""
        config = ZenohConfig(namespace=self.site.namespace, connect=(self.site.endpoint(host),))
        return with_certificate(config, keys or self.keys, name)

    def settle(self) -> None:
        """What was sent before by anybody has arrived: a legitimate message from each remote host comes after it."""
        for host, key in (("pi0", "pi0/radar/tracks"), ("infra0", "infra0/infra_lidar/tracks")):
            mark = b"settled %d" % time.monotonic_ns()

            def came_through(host: str = host, key: str = key, mark: bytes = mark) -> bool:
                self.clients[host].put(key, mark)
                return (key, mark) in self.received

            _until(came_through)

    def hears(self, payload: bytes) -> bool:
        self.settle()
        return any(content == payload for _, content in self.received)

    def close(self) -> None:
        for session in (self._kept[0], *self.clients.values(), *self.routers.values()):
            close_session(session)


@pytest.fixture(scope="module")
def yard(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Yard]:
    folder = tmp_path_factory.mktemp("yard") / "keys"
    authority.init(folder, "spotter")
    for host in HOSTS:
        authority.issue(folder, host, "host", ("127.0.0.1",))
    for laptop in ("laptop1", "thief"):
        authority.issue(folder, laptop, "laptop")
    authority.revoke(folder, "thief")
    authority.issue(folder, "stranger", "host", ("127.0.0.1",))  # a valid certificate that no site file names
    yard = Yard(make_site(free_port, **HOSTS), folder)
    yard.settle()
    yield yard
    yard.close()
