"""A small site with certificates, made once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from common.security import authority
from common.site import HostConfig, ServicePlace, Site


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
