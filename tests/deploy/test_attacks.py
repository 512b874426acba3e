"""The attack list, each tried with real sessions against real routers: what must not get in does not.

A listener on the vehicle's own router hears everything that fusion would hear; a second session always looks, because
a refused writer gets no error and still hears itself.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh
from cryptography import x509
from msgspec.structs import replace

from common import topics
from common.codec import decode, encode
from common.config import ZenohConfig
from common.messages import RadarTracks, Verdict
from common.security import authority
from common.security.router import laptop_config, router_config, with_certificate
from common.session import build, close_session, open_session
from common.site import HostConfig, ServicePlace, Site

pytestmark = pytest.mark.timeout(60)
BUDGET_S = 20.0
HOSTS = {"pi0": ("radar",), "jetson0": ("lidar", "camera", "fusion"), "infra0": ("infra_lidar",)}


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

    def settle(self) -> None:
        """What was sent before by anybody has arrived: a legitimate message from each remote host comes after it."""
        for host, key in (("pi0", "pi0/radar/tracks"), ("infra0", "infra0/infra_lidar/tracks")):
            mark, deadline_s = b"settled %d" % time.monotonic_ns(), time.monotonic() + BUDGET_S
            while (key, mark) not in self.heard:
                self.clients[host].put(key, mark)
                assert time.monotonic() < deadline_s, f"{key} does not come through"
                time.sleep(0.02)

    def hears(self, payload: bytes) -> bool:
        self.settle()
        return any(heard == payload for _, heard in self.heard)

    def close(self) -> None:
        for session in (self._kept[0], *self.clients.values(), *self.routers.values()):
            close_session(session)


@pytest.fixture(scope="module")
def yard(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Yard]:
    import socket

    def free() -> int:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            return int(probe.getsockname()[1])

    folder = tmp_path_factory.mktemp("yard") / "keys"
    authority.init(folder, "spotter")
    hosts = {}
    for host, services in HOSTS.items():
        authority.issue(folder, host, "host", ("127.0.0.1",))
        places = {service: ServicePlace() for service in services}
        hosts[host] = HostConfig(local_port=free(), port=free(), services=places)
    authority.issue(folder, "laptop1", "laptop")
    authority.issue(folder, "thief", "laptop")
    authority.revoke(folder, "thief")
    authority.issue(folder, "stranger", "host", ("127.0.0.1",))  # a valid certificate that no site file names
    yard = Yard(Site(hosts=hosts), folder)
    yard.settle()
    yield yard
    yard.close()


def refused(config: ZenohConfig) -> bool:
    """No session comes up, or it is closed at once."""
    try:
        session = open_session(config, give_up_after_s=1.0)
    except ConnectionError:
        return True
    deadline_s = time.monotonic() + 2.0
    while session.info.transports() and time.monotonic() < deadline_s:
        time.sleep(0.02)
    alone = not session.info.transports()
    close_session(session)
    return alone


def as_laptop(yard: Yard, keys: Path, name: str) -> ZenohConfig:
    config = ZenohConfig(namespace="spotter", connect=(yard.site.endpoint("jetson0"),))
    return with_certificate(config, keys, name)


def test_a_plain_tcp_client_is_refused(yard: Yard) -> None:
    endpoint = yard.site.endpoint("jetson0").replace("tls/", "tcp/")
    assert refused(ZenohConfig(namespace="spotter", connect=(endpoint,)))


def test_a_client_without_a_certificate_is_refused(yard: Yard) -> None:
    ca = {"root_ca_certificate": str(yard.keys / "ca.crt")}
    config = ZenohConfig(connect=(yard.site.endpoint("jetson0"),), extra={"transport/link/tls": ca})
    assert refused(config)


def test_a_certificate_of_another_authority_is_refused(yard: Yard, tmp_path: Path) -> None:
    authority.init(tmp_path, "elsewhere")
    authority.issue(tmp_path, "laptop1", "laptop")
    (tmp_path / "ca.crt").write_bytes((yard.keys / "ca.crt").read_bytes())  # it trusts us; we do not trust it
    assert refused(as_laptop(yard, tmp_path, "laptop1"))


def test_an_expired_certificate_is_refused(yard: Yard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ca.crt", "ca.key", "names.json"):
        (tmp_path / name).write_bytes((yard.keys / name).read_bytes())
    original = x509.CertificateBuilder.not_valid_after
    past = authority.dt.datetime.now(authority.dt.UTC) - authority.dt.timedelta(hours=1)
    monkeypatch.setattr(x509.CertificateBuilder, "not_valid_after", lambda self, _: original(self, past))
    authority.issue(tmp_path, "laptop1", "laptop")
    assert refused(as_laptop(yard, tmp_path, "laptop1"))


@pytest.mark.parametrize("name", ["thief", "stranger"])
def test_a_revoked_or_unknown_name_hears_and_says_nothing(yard: Yard, name: str) -> None:
    session = open_session(as_laptop(yard, yard.keys, name), give_up_after_s=BUDGET_S)
    heard: list[zenoh.Sample] = []
    session.put("pi0/radar/tracks", b"from " + name.encode())
    session.declare_subscriber("**", heard.append)  # after the put: a session hears itself
    assert not yard.hears(b"from " + name.encode())
    assert not heard
    assert not list(session.liveliness().get("**", timeout=0.5))
    close_session(session)


def test_a_laptop_hears_everything_and_says_nothing(yard: Yard) -> None:
    laptop = yard.laptop()
    got: list[str] = []
    laptop.declare_subscriber("**", lambda sample: got.append(str(sample.key_expr)))
    forged = encode(RadarTracks(stamp_ns=1, tracks=[], level="IMMINENT", settled=True, noise_floor_db=0.0))
    laptop.put("pi0/radar/tracks", forged)
    laptop.put("jetson0/fusion/verdict", forged)
    token = laptop.liveliness().declare_token("pi0/radar/alive/laptop")
    assert not yard.hears(forged)
    assert not yard.tokens
    deadline_s = time.monotonic() + BUDGET_S
    while not {"pi0/radar/tracks", "infra0/infra_lidar/tracks"} <= set(got) and time.monotonic() < deadline_s:
        yard.settle()
    assert {"pi0/radar/tracks", "infra0/infra_lidar/tracks"} <= set(got)
    token.undeclare()
    close_session(laptop)


def test_a_laptop_may_ask(yard: Yard) -> None:
    key = topics.info_key("pi0", "radar")

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(key, b"here")

    queryable = yard.clients["pi0"].declare_queryable(key, answer)
    laptop = yard.laptop()
    deadline_s, answers = time.monotonic() + BUDGET_S, []
    while not answers and time.monotonic() < deadline_s:
        answers = [reply.ok.payload.to_bytes() for reply in laptop.get(key, timeout=1.0) if reply.ok is not None]
    assert answers == [b"here"]
    queryable.undeclare()
    close_session(laptop)


def test_the_pi_cannot_give_a_verdict_nor_speak_for_another_host(yard: Yard) -> None:
    pi = yard.clients["pi0"]
    for key in ("jetson0/fusion/verdict", "jetson0/lidar/zones", "infra0/infra_lidar/tracks", "pi0/lidar/zones", "x"):
        pi.put(key, b"from the pi")
    tokens = [pi.liveliness().declare_token(f"{where}/alive/1") for where in ("infra0/infra_lidar", "jetson0/fusion")]
    assert not yard.hears(b"from the pi")
    assert not yard.tokens
    for token in tokens:
        token.undeclare()


def test_a_stolen_host_certificate_is_worth_that_host_only(yard: Yard) -> None:
    """Somebody with the Pi's key dials the vehicle directly, past the Pi's own router."""
    session = open_session(as_laptop(yard, yard.keys, "pi0"), give_up_after_s=BUDGET_S)
    session.put("jetson0/fusion/verdict", b"stolen")
    session.put("infra0/infra_lidar/tracks", b"stolen")
    assert not yard.hears(b"stolen")
    close_session(session)


def test_nobody_relays_for_a_third_host(yard: Yard) -> None:
    """infra0's router does not pass the Pi's words on to the vehicle, nor would the vehicle believe it."""
    session = open_session(as_laptop(yard, yard.keys, "infra0"), give_up_after_s=BUDGET_S)
    session.put("pi0/radar/tracks", b"relayed")
    got: list[str] = []
    session.declare_subscriber("**", lambda sample: got.append(str(sample.key_expr)))
    yard.clients["jetson0"].put("jetson0/fusion/verdict", b"own")
    assert not yard.hears(b"relayed")
    assert "pi0/radar/tracks" not in got
    close_session(session)


def test_a_flood_from_a_laptop_does_not_delay_the_tracks(yard: Yard) -> None:
    laptop = yard.laptop()
    for _ in range(20_000):
        laptop.put("pi0/radar/tracks", b"flood" * 20)
    begun_s = time.monotonic()
    yard.settle()
    assert time.monotonic() - begun_s < BUDGET_S
    assert not any(payload.startswith(b"flood") for _, payload in yard.heard)
    close_session(laptop)


@pytest.mark.parametrize("payload", [b"", b"\xc1", b"\x81\xa8stamp_ns", b"\x00" * 5_000_000], ids=len)
def test_malformed_and_oversized_payloads_are_refused_by_the_reader(yard: Yard, payload: bytes) -> None:
    """Even from the owner itself: the reader counts and drops them (see also tests/common/test_codec.py)."""
    with pytest.raises(ValueError, match=r"."):
        decode(payload, RadarTracks, topics.RADAR_TRACKS.max_bytes)
    with pytest.raises(ValueError, match=r"."):
        decode(payload, Verdict)


def test_a_revocation_counts_after_the_routers_restart(yard: Yard, free_ports: Callable[[], int]) -> None:
    """A site of its own, so that the others keep theirs: the laptop hears before, and nothing after."""
    site = Site(
        hosts={"pi0": HostConfig(local_port=free_ports(), port=free_ports(), services={"radar": ServicePlace()})}
    )
    authority.issue(yard.keys, "guest", "laptop")

    def hears_the_radar() -> bool:
        router = zenoh.open(build(router_config(site, "pi0", yard.keys)))
        own = open_session(ZenohConfig(connect=(site.hosts["pi0"].loopback,)), give_up_after_s=BUDGET_S)
        guest = open_session(replace(laptop_config(site, "guest", yard.keys, "pi0")), give_up_after_s=BUDGET_S)
        heard: list[zenoh.Sample] = []
        guest.declare_subscriber("pi0/radar/tracks", heard.append)
        deadline_s = time.monotonic() + 1.5
        while not heard and time.monotonic() < deadline_s:
            own.put("pi0/radar/tracks", b"x")
            time.sleep(0.02)
        for session in (guest, own, router):
            close_session(session)
        return bool(heard)

    assert hears_the_radar()
    authority.revoke(yard.keys, "guest")
    assert not hears_the_radar()
