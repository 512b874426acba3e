"""What doctor finds over the network: every fault is really there, on real routers, and is named with what to do."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh
from msgspec.structs import replace
from typer.testing import CliRunner

from common.bus.runtime import Service
from common.bus.session import close_session, open_session
from common.codec import encode, encoding_of
from common.config import ServiceConfig, ZenohConfig
from common.host.site import HostConfig, ServicePlace, Site, TlsConfig
from common.messages import ClockReply, RadarTracks, SensorHealth, ServiceInfo, SystemHealth
from common.topics import RADAR_TRACKS
from spotter_tools.cli.__main__ import app
from spotter_tools.doctor.bus import check_bus, check_from_laptop
from spotter_tools.doctor.findings import Finding

pytestmark = [pytest.mark.patient, pytest.mark.timeout(60)]
TRACKS = RadarTracks(stamp_ns=1, tracks=[], level="SAFE", settled=True, noise_floor_db=-60.0, frame_id="radar")
SILENT_SENSOR = SensorHealth(state="disconnected", reason="no data for 0.5 s", since_ns=1, age_ms=None, rate_hz=0.0)
HEALTH = SystemHealth(
    stamp_ns=1, frame_id="", sensors={"radar": SILENT_SENSOR}, colour="red", summary="", services={}, clocks={}
)


def grades(found: Iterable[Finding]) -> dict[str, str]:
    listed = list(found)
    assert all(finding.do for finding in listed if finding.grade != "ok")
    return {finding.check: finding.grade for finding in listed}


@contextmanager
def again_and_again(act: Callable[[], object]) -> Iterator[None]:
    """Twenty times a second, until the block ends."""
    over = threading.Event()

    def repeat() -> None:
        while not over.wait(0.05):
            act()

    thread = threading.Thread(target=repeat)
    thread.start()
    yield
    over.set()
    thread.join()


def answering(session: zenoh.Session, key: str, answer: Callable[[zenoh.Query], bytes]) -> zenoh.Queryable:
    def reply(query: zenoh.Query) -> None:
        with query:
            query.reply(key, answer(query))

    return session.declare_queryable(key, reply)


@contextmanager
def radar(endpoint: str) -> Iterator[None]:
    """A radar service that is as it should be."""
    with Service("radar", ServiceConfig(host="pi0", zenoh=ZenohConfig(connect=(endpoint,)))) as service:
        publish = service.publisher(RADAR_TRACKS)
        with again_and_again(lambda: publish(replace(TRACKS, stamp_ns=time.time_ns()))):
            yield


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everybody is on this machine: nobody needs the time of a real network."""
    monkeypatch.setattr("spotter_tools.doctor.bus.ANSWER_S", 0.6)


@pytest.fixture
def open_site(router_endpoint: str, free_ports: Callable[[], int]) -> Site:
    """One host, its router without any rules."""
    port = int(router_endpoint.rsplit(":", 1)[1])
    host = HostConfig(local_port=port, port=free_ports(), services={"radar": ServicePlace()})
    return Site(hosts={"pi0": host}, tls=TlsConfig(enabled=False))


@pytest.fixture
def client(router_endpoint: str) -> Iterator[zenoh.Session]:
    session = open_session(ZenohConfig(connect=(router_endpoint,)), give_up_after_s=10.0)
    yield session
    close_session(session)


def test_a_host_in_order(open_site: Site, router_endpoint: str) -> None:
    with radar(router_endpoint):
        found = grades(check_bus(open_site, "pi0"))
    assert found == {
        "own router": "ok", "hear pi0/radar": "ok", "clock pi0/radar": "ok", "hear pi0/radar/tracks": "ok",
        "hear pi0/radar/motion": "warning",  # nobody decides by it, and it can be switched off
    }  # fmt: skip


def test_a_router_that_is_not_there(open_site: Site, free_ports: Callable[[], int]) -> None:
    gone = Site(hosts={"pi0": HostConfig(local_port=free_ports(), port=free_ports())})
    assert grades(check_bus(gone, "pi0")) == {"own router": "broken"}


def test_a_service_that_does_not_answer_and_says_nothing(open_site: Site) -> None:
    found = grades(check_bus(open_site, "pi0"))
    assert found["hear pi0/radar"] == "broken"
    assert found["hear pi0/radar/tracks"] == "broken"


def test_a_service_that_answers_and_says_nothing(open_site: Site, router_endpoint: str) -> None:
    with Service("radar", ServiceConfig(host="pi0", zenoh=ZenohConfig(connect=(router_endpoint,)))):
        found = grades(check_bus(open_site, "pi0"))
    assert found["hear pi0/radar"] == "ok"
    assert found["hear pi0/radar/tracks"] == "broken"


def test_another_host_that_cannot_be_dialled(open_site: Site, free_ports: Callable[[], int]) -> None:
    hosts = {**open_site.hosts, "infra0": HostConfig(local_port=free_ports(), port=free_ports())}
    found = grades(check_bus(replace(open_site, hosts=hosts), "pi0"))
    assert found["reach infra0"] == "broken"


def test_a_router_that_keeps_no_rules(open_site: Site, router_endpoint: str) -> None:
    with radar(router_endpoint):
        found = grades(check_bus(replace(open_site, tls=TlsConfig()), "pi0"))
    assert found["access rules"] == "broken"


def test_another_version(open_site: Site, client: zenoh.Session) -> None:
    info = ServiceInfo(
        stamp_ns=1, frame_id="", service="radar", host="pi0", instance="1", version="9.9.9", config_hash="x",
        topics=[], started_ns=1, pid=1,
    )  # fmt: skip
    kept = answering(client, "pi0/radar/info", lambda query: encode(info))
    found = grades(check_bus(open_site, "pi0"))
    assert found["hear pi0/radar"] == "ok"
    assert found["version pi0/radar"] == "broken"
    kept.undeclare()


@pytest.mark.parametrize(
    ("payload", "encoding"),
    [
        (encode(TRACKS), "application/msgpack;spotter.RadarTracks.v2"),
        (encode(HEALTH), encoding_of(RadarTracks)),
        (b"\xc1", encoding_of(RadarTracks)),
    ],
    ids=["another version", "another message", "garbage"],
)
def test_a_schema_that_does_not_match(open_site: Site, client: zenoh.Session, payload: bytes, encoding: str) -> None:
    with again_and_again(lambda: client.put("pi0/radar/tracks", payload, encoding=encoding)):
        assert grades(check_bus(open_site, "pi0"))["schema pi0/radar/tracks"] == "broken"


@pytest.mark.parametrize(
    ("offset_s", "message"),
    [(5.0, "+"), (-56 * 365.25 * 86400.0, "clock of pi0 is 56 years behind")],
    ids=["five seconds", "1970"],
)
def test_a_clock_that_is_off(
    open_site: Site, client: zenoh.Session, router_endpoint: str, offset_s: float, message: str
) -> None:
    def by_that_clock(query: zenoh.Query) -> bytes:
        then_ns = time.time_ns() + int(offset_s * 1e9)
        asked_ns = int.from_bytes(query.payload.to_bytes(), "little")
        return encode(ClockReply(stamp_ns=asked_ns, frame_id="", request_received_ns=then_ns, reply_sent_ns=then_ns))

    kept = answering(client, "pi0/radar/clock", by_that_clock)
    info = ServiceInfo(
        stamp_ns=1, frame_id="", service="radar", host="pi0", instance="1", version="x", config_hash="x", topics=[],
        started_ns=1, pid=1,
    )  # fmt: skip
    also = answering(client, "pi0/radar/info", lambda query: encode(info))
    (found,) = [one for one in check_bus(open_site, "pi0") if one.check == "clock pi0/radar"]
    assert (found.grade, found.what.startswith(message)) == ("broken", True), found
    kept.undeclare()
    also.undeclare()


def test_a_sensor_that_fusion_does_not_hear(open_site: Site, client: zenoh.Session, router_endpoint: str) -> None:
    here = replace(open_site.hosts["pi0"], services={"radar": ServicePlace(), "fusion": ServicePlace()})
    site = replace(open_site, hosts={"pi0": here})
    assert grades(check_bus(site, "pi0"))["hear pi0/fusion/health"] == "broken"  # nobody there to ask
    say = partial(client.put, "pi0/fusion/health", encode(HEALTH), encoding=encoding_of(SystemHealth))
    with again_and_again(say), radar(router_endpoint):
        assert grades(check_bus(site, "pi0"))["seen by pi0: radar"] == "broken"


@pytest.fixture(scope="module")
def inhabited(yard: Any) -> Iterator[SimpleNamespace]:
    """A corner of the yard, with a radar on the Pi and nobody at the roadside."""
    pi0 = replace(yard.site.hosts["pi0"], services={"radar": ServicePlace()})
    site = replace(yard.site, hosts={"pi0": pi0, "infra0": yard.site.hosts["infra0"]})
    with radar(pi0.loopback):
        yield SimpleNamespace(site=site, keys=yard.keys)


def test_a_laptop_in_order_hears_the_radar_and_is_kept_to_the_rules(inhabited: SimpleNamespace) -> None:
    found = grades(check_from_laptop(inhabited.site, "laptop1", inhabited.keys))
    for check in ("reach pi0", "enter pi0", "hear pi0/radar", "hear pi0/radar/tracks", "access rules"):
        assert found[check] == "ok", check
    assert found["hear infra0/infra_lidar"] == "broken"  # nobody runs it


def test_a_revoked_laptop_hears_nothing(inhabited: SimpleNamespace) -> None:
    found = grades(check_from_laptop(inhabited.site, "thief", inhabited.keys))
    assert found["hear pi0/radar/tracks"] == "broken"


def test_a_laptop_without_its_certificate_or_with_no_way_in(
    inhabited: SimpleNamespace, free_ports: Callable[[], int]
) -> None:
    assert grades(check_from_laptop(inhabited.site, "nobody", inhabited.keys))["enter pi0"] == "broken"
    with ExitStack() as stack:
        closed = stack.enter_context(socket.create_server(("127.0.0.1", 0)))  # somebody listens, and it is no router
        site = Site(hosts={"pi0": HostConfig(port=closed.getsockname()[1], local_port=free_ports())})
        assert grades(check_from_laptop(site, "laptop1", inhabited.keys))["enter pi0"] == "broken"
    site = Site(hosts={"pi0": HostConfig(port=free_ports(), local_port=free_ports())})
    assert grades(check_from_laptop(site, "laptop1", inhabited.keys)) == {"reach pi0": "broken"}


def test_the_command_knows_a_laptop_by_its_name(inhabited: SimpleNamespace, tmp_path: Path) -> None:
    lines = [f'[tls]\nkeys = "{inhabited.keys}"']
    for host, config in inhabited.site.hosts.items():
        lines += [f"[hosts.{host}]\nport = {config.port}\nlocal_port = {config.local_port}"]
        lines += [f"[hosts.{host}.services.{service}]" for service in config.services]
    (tmp_path / "site.toml").write_text("\n".join(lines))

    def says(name: str) -> tuple[int, dict[str, dict[str, str]]]:
        result = CliRunner().invoke(app, ["doctor", name, "--site", str(tmp_path / "site.toml"), "--json"])
        return result.exit_code, {row["check"]: row for row in map(json.loads, result.output.splitlines())}

    _, found = says("laptop1")
    assert found["enter pi0"]["grade"] == found["hear pi0/radar"]["grade"] == "ok"
    assert {"disk", "clock", "versions"} <= set(found)
    code, found = says("thief")
    assert code == 1
    assert [check for check, row in found.items() if row["grade"] == "broken"] == ["names"]  # no blame on the hosts
    assert found["names"]["do"] == "`spotter keys laptop thief` issues a new one"
