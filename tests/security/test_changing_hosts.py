"""What changes while a site runs: a certificate expires, an address moves, a second computer takes a host's name."""

from __future__ import annotations

import datetime as dt
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh
from cryptography import x509
from msgspec.structs import replace

from common import topics
from common.bus.presence import Presence
from common.bus.runtime import Service
from common.bus.session import build, close_session, open_session
from common.codec import decode
from common.config import ServiceConfig, ZenohConfig
from common.host.site import HostConfig, ServicePlace, Site
from common.messages import RadarTracks, SystemHealth
from common.security import authority
from common.security.router_config import router_config
from spotter_tools.doctor.link_faults import OwnFiles, link_fault

pytestmark = [pytest.mark.system, pytest.mark.timeout(120)]
Until = Callable[..., None]
FUSION = Path(sys.executable).with_name("spotter-fusion")


class Two:
    """pi0 with a radar and jetson0 with a lidar, linked by TLS; ``seen`` is who jetson0 sees."""

    def __init__(self, stack: ExitStack, folder: Path, free: Callable[[], int]) -> None:
        self.stack, self.folder = stack, folder
        services = {"pi0": ("radar",), "jetson0": ("lidar", "fusion")}
        hosts = {
            name: HostConfig(port=free(), local_port=free(), services={one: ServicePlace() for one in own})
            for name, own in services.items()
        }
        self.site = Site(hosts=hosts)
        authority.init(folder, "spotter")
        for host in hosts:
            authority.issue(folder, host, "host", ("127.0.0.1",))

    def router(self, host: str, site: Site | None = None) -> zenoh.Session:
        session = zenoh.open(build(router_config(site or self.site, host, self.folder)))
        self.stack.callback(close_session, session)
        return session

    def bus(self, host: str, site: Site | None = None) -> ZenohConfig:
        return ZenohConfig(connect=((site or self.site).host(host).loopback,))

    def service(self, name: str, host: str, site: Site | None = None) -> Service:
        return self.stack.enter_context(Service(name, ServiceConfig(host=host, zenoh=self.bus(host, site))))

    def onlooker(self) -> Presence:
        session = open_session(self.bus("jetson0"), give_up_after_s=20.0)
        self.stack.callback(close_session, session)
        return Presence(session)

    def fault(self) -> str:
        """What the router of jetson0 would say of pi0."""
        files = OwnFiles(self.folder / "ca.crt", self.folder / "jetson0.crt", self.folder / "jetson0.key")
        pi0 = self.site.host("pi0")
        fault = link_fault(files, "pi0", pi0.address, pi0.port)
        return fault.why if fault else ""


@pytest.fixture
def two(tmp_path: Path, free_ports: Callable[[], int]) -> Iterator[Two]:
    with ExitStack() as stack:
        yield Two(stack, tmp_path / "keys", free_ports)


def test_a_certificate_that_expires_while_running(two: Two, monkeypatch: pytest.MonkeyPatch, until: Until) -> None:
    """The link ends with it and the reason is named; own services go on; a new certificate heals it."""
    ends = dt.datetime.now(dt.UTC) + dt.timedelta(seconds=6)
    original = x509.CertificateBuilder.not_valid_after
    with monkeypatch.context() as short:
        short.setattr(x509.CertificateBuilder, "not_valid_after", lambda self, _: original(self, ends))
        authority.issue(two.folder, "pi0", "host", ("127.0.0.1",))
    old = two.router("pi0")
    two.router("jetson0")
    two.service("radar", "pi0")
    two.service("lidar", "jetson0")
    seen = two.onlooker()
    until(lambda: names(seen) == {"radar", "lidar"})
    until(lambda: names(seen) == {"lidar"})
    assert dt.datetime.now(dt.UTC) >= ends - dt.timedelta(seconds=1)  # not before
    assert two.fault() == "the certificate of pi0 has expired: issue it again with `spotter keys host pi0`"
    authority.issue(two.folder, "pi0", "host", ("127.0.0.1",))
    close_session(old)  # the router of pi0 begins again by itself once it sees the new certificate (test_attacks)
    two.router("pi0")
    until(lambda: names(seen) == {"radar", "lidar"})
    assert two.fault() == ""


def test_a_host_whose_address_changes(two: Two, until: Until) -> None:
    """A certificate is for an address: the new one needs another, and both sides the new site file."""
    moved = replace(two.site, hosts={**two.site.hosts, "pi0": replace(two.site.host("pi0"), address="127.0.0.2")})
    pi0, jetson0 = two.router("pi0"), two.router("jetson0")
    two.service("radar", "pi0")
    two.service("lidar", "jetson0")
    seen = two.onlooker()
    until(lambda: names(seen) == {"radar", "lidar"})
    close_session(pi0)
    pi0 = two.router("pi0", moved)
    until(lambda: names(seen) == {"lidar"})  # the own services go on; jetson0 still dials the old address
    two.site = moved
    assert two.fault().startswith("the certificate of pi0 is not for 127.0.0.2: issue it again with")
    authority.issue(two.folder, "pi0", "host", ("127.0.0.2",))
    for router in (pi0, jetson0):
        close_session(router)
    two.router("pi0")
    two.router("jetson0")
    until(lambda: names(seen) == {"radar", "lidar"})


def test_two_computers_of_one_name_are_told_while_the_verdict_goes_on(
    two: Two, free_ports: Callable[[], int], until: Until
) -> None:
    """A copied card: the same certificate and name on another computer. Each radar is well, together they are not."""
    two.site = replace(two.site, hosts={name: two.site.host(name) for name in ("jetson0", "pi0")})  # pi0 dials
    own = two.site.host("pi0")
    copy = replace(two.site, hosts={**two.site.hosts, "pi0": replace(own, port=free_ports(), local_port=free_ports())})
    two.router("jetson0")
    two.router("pi0")
    two.router("pi0", copy)
    speak = [two.service("radar", "pi0", site).publisher(topics.RADAR_TRACKS) for site in (two.site, copy)]
    local = two.bus("jetson0")
    words = ("--set", f'zenoh.connect=["{local.connect[0]}"]')
    process = two.stack.enter_context(subprocess.Popen([str(FUSION), *words], stderr=subprocess.DEVNULL))
    two.stack.callback(process.terminate)
    laptop, causes, verdicts = open_session(local), list[str](), list[zenoh.Sample]()
    two.stack.callback(close_session, laptop)
    laptop.declare_subscriber(topics.FUSION_VERDICT.any_host, verdicts.append)
    laptop.declare_subscriber(
        topics.FUSION_HEALTH.any_host,
        lambda sample: causes.append(decode(sample.payload.to_bytes(), SystemHealth).sensors["radar"].cause),
    )

    def reported() -> bool:
        for publish in speak:
            publish(RadarTracks(stamp_ns=time.time_ns(), tracks=[], level="SAFE", settled=True, noise_floor_db=-60.0))
        return "two_claimants" in causes

    until(reported)
    before = len(verdicts)
    until(lambda: len(verdicts) > before + 20)


def names(seen: Presence) -> set[str]:
    return {service for _, service, _ in seen.instances()}
