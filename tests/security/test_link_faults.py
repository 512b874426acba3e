"""Two routers with certificates that cannot be linked: the clock or the certificate is named, wherever one looks."""

from __future__ import annotations

import datetime as dt
import logging
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh
from cryptography import x509
from typer.testing import CliRunner

from common.bus.session import build, close_session, open_session
from common.config import ZenohConfig
from common.host.site import HostConfig, ServicePlace, Site
from common.messages import LinkFault
from common.security import authority
from common.security.router_config import router_config
from services.jetson.fusion.source import ask_router
from spotter_tools.cli.__main__ import app
from spotter_tools.doctor import link_faults
from spotter_tools.doctor.bus import check_bus
from spotter_tools.doctor.link_faults import OwnFiles, link_fault, own_fault
from spotter_tools.router_links import LinkWatch

pytestmark = pytest.mark.system


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    keys = tmp_path / "keys"
    authority.init(keys, "spotter")
    for host in ("pi0", "jetson0"):
        authority.issue(keys, host, "host", ("127.0.0.1",))
    return keys


@pytest.fixture
def site(free_ports: Callable[[], int]) -> Site:
    services = {"pi0": "radar", "jetson0": "fusion"}
    return Site(
        hosts={
            host: HostConfig(port=free_ports(), local_port=free_ports(), services={name: ServicePlace()})
            for host, name in services.items()
        }
    )


def own(folder: Path, name: str = "jetson0") -> OwnFiles:
    return OwnFiles(folder / "ca.crt", folder / f"{name}.crt", folder / f"{name}.key")


@pytest.fixture
def pi0(site: Site, folder: Path) -> Iterator[tuple[str, int]]:
    """The real router of pi0, as Zenoh makes it."""
    router = zenoh.open(build(router_config(site, "pi0", folder)))
    yield "127.0.0.1", site.host("pi0").port
    close_session(router)


def in_a_day(monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on certificates begin to be valid tomorrow, as every certificate does to a clock of 1970."""
    monkeypatch.setattr(authority, "BACKDATED", -dt.timedelta(days=1))


def expired(monkeypatch: pytest.MonkeyPatch) -> None:
    original, past = x509.CertificateBuilder.not_valid_after, dt.datetime.now(dt.UTC) - dt.timedelta(hours=1)
    monkeypatch.setattr(x509.CertificateBuilder, "not_valid_after", lambda self, _: original(self, past))


def test_two_hosts_in_order_have_nothing_between_them(folder: Path, pi0: tuple[str, int]) -> None:
    assert link_fault(own(folder), "pi0", *pi0) is None


def test_a_host_where_nobody_answers_is_not_judged(folder: Path, free_ports: Callable[[], int]) -> None:
    assert link_fault(own(folder), "pi0", "127.0.0.1", free_ports()) is None


def test_the_other_clock_is_named(folder: Path, pi0: tuple[str, int], monkeypatch: pytest.MonkeyPatch) -> None:
    """To pi0 our certificate is not valid yet; by our own clock it is, which is what is left out here."""
    in_a_day(monkeypatch)
    authority.issue(folder, "jetson0", "host", ("127.0.0.1",))
    monkeypatch.setattr(link_faults, "own_fault", lambda _: None)
    fault = link_fault(own(folder), "pi0", *pi0)
    assert fault is not None
    assert (fault.cause, fault.why.startswith("clock of pi0 is wrong")) == ("clock", True)


def test_the_own_clock_is_named(folder: Path, pi0: tuple[str, int], monkeypatch: pytest.MonkeyPatch) -> None:
    in_a_day(monkeypatch)
    authority.issue(folder, "jetson0", "host", ("127.0.0.1",))
    fault = link_fault(own(folder), "pi0", *pi0)
    assert fault is not None
    assert fault.cause == "clock"
    assert "this host's clock says" in fault.why


def test_the_own_certificate_that_has_expired_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expired(monkeypatch)
    authority.issue(folder, "jetson0", "host", ("127.0.0.1",))
    fault = own_fault(own(folder))
    assert fault is not None
    assert fault.why == "the certificate of jetson0 has expired: issue it again with `spotter keys host jetson0`"


@pytest.mark.parametrize(
    ("spoil", "addresses", "cause", "reason"),
    [
        (expired, ("127.0.0.1",), "certificate", "the certificate of pi0 has expired: issue it again with"),
        (in_a_day, ("127.0.0.1",), "clock", "the certificate of pi0 begins after"),
        (lambda _: None, ("10.0.0.7",), "certificate", "the certificate of pi0 is not for 127.0.0.1"),
    ],
    ids=["expired", "from the future", "another address"],
)
def test_their_certificate_is_named(
    folder: Path,
    site: Site,
    monkeypatch: pytest.MonkeyPatch,
    spoil: Callable[[pytest.MonkeyPatch], None],
    addresses: tuple[str, ...],
    cause: str,
    reason: str,
) -> None:
    with monkeypatch.context() as meanwhile:
        spoil(meanwhile)
        authority.issue(folder, "pi0", "host", addresses)
    router = zenoh.open(build(router_config(site, "pi0", folder)))
    fault = link_fault(own(folder), "pi0", "127.0.0.1", site.host("pi0").port)
    close_session(router)
    assert fault is not None
    assert (fault.cause, fault.why.startswith(reason)) == (cause, True), fault


def test_a_stranger_on_the_port_is_not_judged(folder: Path, router_endpoint: str) -> None:
    """A router without TLS answers in no way that could be taken for an alert."""
    assert link_fault(own(folder), "pi0", "127.0.0.1", int(router_endpoint.rpartition(":")[2])) is None


def test_log_health_fusion_and_doctor_name_the_clock(
    folder: Path,
    site: Site,
    monkeypatch: pytest.MonkeyPatch,
    until: Callable[..., None],
    caplog: pytest.LogCaptureFixture,
) -> None:
    why = "clock of pi0 is wrong: to it the certificate of jetson0, which is in date, is out of date"
    pi0 = zenoh.open(build(router_config(site, "pi0", folder)))
    in_a_day(monkeypatch)
    authority.issue(folder, "jetson0", "host", ("127.0.0.1",))
    monkeypatch.setattr(link_faults, "own_fault", lambda _: None)
    config = router_config(site, "jetson0", folder)
    router = zenoh.open(build(config))
    local = ZenohConfig(namespace=site.namespace, connect=(site.host("jetson0").loopback,))
    client = open_session(local, give_up_after_s=10.0)
    try:
        with caplog.at_level(logging.ERROR, "router"):
            watch = LinkWatch(router, site, "jetson0", config)
            until(lambda: ask_router(client, "jetson0") == {"pi0": LinkFault(cause="clock", why=why)})
            assert caplog.messages == [f"pi0 is not linked: {why}"]
        shown = CliRunner().invoke(app, ["health", "--connect", local.connect[0]])
        assert shown.exit_code == 1
        assert f"jetson0 has no link to pi0: {why}" in shown.stderr
        found = {one.check: one for one in check_bus(site, "jetson0")}
        assert (found["link pi0"].what, found["link pi0"].do) == (
            why,
            "set the clock (chrony); the certificates are in order",
        )
        watch.close()
    finally:
        for session in (client, router, pi0):
            close_session(session)
