"""A small site with certificates, made once, and a yard of real routers to break into."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh

from common.config import ZenohConfig
from common.security import authority
from common.security.router import laptop_config, router_config, with_certificate
from common.session import build, close_session, open_session
from common.site import HostConfig, ServicePlace, Site

BUDGET_S = 20.0
HOSTS = {
    "pi0": ("radar", "blackbox"),
    "jetson0": ("lidar", "camera", "fusion"),
    "infra0": ("infra_lidar",),
}


def make_site(free: Callable[[], int], **services: tuple[str, ...]) -> Site:
    """Hosts with these services, on loopback and free ports."""
    hosts = {
        host: HostConfig(local_port=free(), port=free(), services={name: ServicePlace() for name in names})
        for host, names in services.items()
    }
    return Site(hosts=hosts)


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


def _until(condition: Callable[[], object], budget_s: float = BUDGET_S) -> None:
    """Look again and again; fail when it is not true within the budget."""
    deadline_s, pause = time.monotonic() + budget_s, threading.Event()
    while not condition():
        assert time.monotonic() < deadline_s, f"not true within {budget_s:g} s"
        pause.wait(0.02)


@pytest.fixture(scope="session")
def until() -> Callable[..., None]:
    return _until


class Yard:
    """Three routers with rules and links, a client on each loopback, and what jetson0's client hears."""

    def __init__(self, site: Site, keys: Path) -> None:
        self.site, self.keys = site, keys
        self.routers = {host: zenoh.open(build(router_config(site, host, keys))) for host in site.hosts}
        self.clients = {host: self.client(host) for host in site.hosts}
        self.heard: list[tuple[str, bytes]] = []
        self.tokens: set[str] = set()
        listener = self.client("jetson0")
        self._kept = [
            listener,
            listener.declare_subscriber("**", lambda s: self.heard.append((str(s.key_expr), s.payload.to_bytes()))),
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
                return (key, mark) in self.heard

            _until(came_through)

    def hears(self, payload: bytes) -> bool:
        self.settle()
        return any(heard == payload for _, heard in self.heard)

    def close(self) -> None:
        for session in (self._kept[0], *self.clients.values(), *self.routers.values()):
            close_session(session)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


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
    yard = Yard(make_site(_free_port, **HOSTS), folder)
    yard.settle()
    yield yard
    yard.close()
