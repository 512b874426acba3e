"""The attack list, each tried with real sessions against real routers: what must not get in does not.

A listener on the vehicle's own router hears everything that fusion would hear; a second session always looks, because
a refused writer gets no error and still hears itself.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from common import topics
from common.bus.session import close_session, open_session
from common.codec import decode, encode
from common.config import ZenohConfig
from common.host.site import load_site
from common.messages import RadarTracks, Verdict
from common.security import authority
from common.security.router_config import laptop_config

pytestmark = pytest.mark.timeout(60)
BUDGET_S = 60.0


def refused(config: ZenohConfig) -> bool:
    """No session comes up, or the router closes it before it has answered anything."""
    try:
        session = open_session(config, give_up_after_s=1.0)
    except ConnectionError:
        return True
    replies = [reply for reply in session.get("pi0/radar/info", timeout=2.0) if reply.ok is not None]
    close_session(session)
    return not replies


@pytest.fixture(scope="module", autouse=True)
def radar(yard: Any) -> zenoh.Queryable:
    """Somebody who answers whoever is let in."""
    key = topics.info_key("pi0", "radar")

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(key, b"here")

    return yard.clients["pi0"].declare_queryable(key, answer)


def test_a_plain_tcp_client_is_refused(yard: Any) -> None:
    endpoint = yard.site.endpoint("jetson0").replace("tls/", "tcp/")
    assert refused(ZenohConfig(namespace="spotter", connect=(endpoint,)))


def test_a_client_without_a_certificate_is_refused(yard: Any) -> None:
    ca = {"root_ca_certificate": str(yard.keys / "ca.crt")}
    config = ZenohConfig(connect=(yard.site.endpoint("jetson0"),), extra={"transport/link/tls": ca})
    assert refused(config)


def test_a_certificate_of_another_authority_is_refused(yard: Any, tmp_path: Path) -> None:
    authority.init(tmp_path, "elsewhere")
    authority.issue(tmp_path, "laptop1", "laptop")
    (tmp_path / "ca.crt").write_bytes((yard.keys / "ca.crt").read_bytes())  # it trusts us; we do not trust it
    assert refused(yard.named("laptop1", tmp_path))


def test_an_expired_certificate_is_refused(yard: Any, tmp_path: Path) -> None:
    for name in ("ca.crt", "ca.key", "names.json"):
        (tmp_path / name).write_bytes((yard.keys / name).read_bytes())
    authority.issue(tmp_path, "laptop1", "laptop", days=-1)
    assert refused(yard.named("laptop1", tmp_path))


@pytest.mark.parametrize("name", ["thief", "stranger"])
def test_a_revoked_or_unknown_name_hears_and_says_nothing(yard: Any, name: str) -> None:
    session = open_session(yard.named(name), give_up_after_s=BUDGET_S)
    received: list[zenoh.Sample] = []
    session.put("pi0/radar/tracks", b"from " + name.encode())
    session.declare_subscriber("**", received.append)  # after the put: a session hears itself
    assert not yard.hears(b"from " + name.encode())
    assert not received
    assert not list(session.liveliness().get("**", timeout=0.5))
    close_session(session)


def test_a_laptop_hears_everything_and_says_nothing(yard: Any, until: Callable[..., None]) -> None:
    laptop = yard.laptop()
    got: list[str] = []
    laptop.declare_subscriber("**", lambda sample: got.append(str(sample.key_expr)))
    forged = encode(RadarTracks(stamp_ns=1, tracks=[], level="IMMINENT", settled=True, noise_floor_db=0.0))
    laptop.put("pi0/radar/tracks", forged)
    laptop.put("jetson0/fusion/verdict", forged)
    token = laptop.liveliness().declare_token("pi0/radar/alive/laptop")
    assert not yard.hears(forged)
    assert not yard.tokens
    until(lambda: (yard.settle(), {"pi0/radar/tracks", "infra0/infra_lidar/tracks"} <= set(got))[1])
    token.undeclare()
    close_session(laptop)


def test_a_laptop_may_ask(yard: Any, until: Callable[..., None]) -> None:
    laptop = yard.laptop()
    until(lambda: [r.ok.payload.to_bytes() for r in laptop.get("pi0/radar/info", timeout=1.0) if r.ok] == [b"here"])
    close_session(laptop)


def test_the_pi_cannot_give_a_verdict_nor_speak_for_another_host(yard: Any) -> None:
    pi = yard.clients["pi0"]
    for key in ("jetson0/fusion/verdict", "jetson0/lidar/zones", "infra0/infra_lidar/tracks", "pi0/lidar/zones", "x"):
        pi.put(key, b"from the pi")
    tokens = [pi.liveliness().declare_token(f"{where}/alive/1") for where in ("infra0/infra_lidar", "jetson0/fusion")]
    assert not yard.hears(b"from the pi")
    assert not yard.tokens
    for token in tokens:
        token.undeclare()


def test_a_stolen_host_certificate_is_worth_that_host_only(yard: Any) -> None:
    """Somebody with the Pi's key dials the vehicle directly, past the Pi's own router."""
    session = open_session(yard.named("pi0"), give_up_after_s=BUDGET_S)
    session.put("jetson0/fusion/verdict", b"stolen")
    session.put("infra0/infra_lidar/tracks", b"stolen")
    assert not yard.hears(b"stolen")
    close_session(session)


def test_nobody_relays_for_a_third_host(yard: Any) -> None:
    """infra0's router does not pass the Pi's words on to the vehicle, nor would the vehicle believe it."""
    session = open_session(yard.named("infra0"), give_up_after_s=BUDGET_S)
    session.put("pi0/radar/tracks", b"relayed")
    got: list[str] = []
    session.declare_subscriber("**", lambda sample: got.append(str(sample.key_expr)))
    yard.clients["jetson0"].put("jetson0/fusion/verdict", b"own")
    assert not yard.hears(b"relayed")
    assert "pi0/radar/tracks" not in got
    close_session(session)


def test_a_flood_from_a_laptop_does_not_delay_the_tracks(yard: Any) -> None:
    laptop = yard.laptop()
    for _ in range(20_000):
        laptop.put("pi0/radar/tracks", b"flood" * 20)
    yard.settle()  # or it fails
    assert not any(payload.startswith(b"flood") for _, payload in yard.received)
    close_session(laptop)


@pytest.mark.parametrize("payload", [b"", b"\xc1", b"\x81\xa8stamp_ns", b"\x00" * 5_000_000], ids=len)
def test_malformed_and_oversized_payloads_are_refused_by_the_reader(yard: Any, payload: bytes) -> None:
    """Even from the owner itself: the reader counts and drops them (see also tests/common/test_codec.py)."""
    with pytest.raises(ValueError, match=r"."):
        decode(payload, RadarTracks, topics.RADAR_TRACKS.max_bytes)
    with pytest.raises(ValueError, match=r"."):
        decode(payload, Verdict)


@pytest.fixture
def gate(tmp_path: Path, free_ports: Callable[[], int]) -> Iterator[SimpleNamespace]:
    """A site of its own with one router as it is deployed: the command, a file, a folder of keys."""
    file, keys = tmp_path / "site.toml", tmp_path / "keys"
    file.write_text(f"[hosts.pi0]\nlocal_port = {free_ports()}\nport = {free_ports()}\n[hosts.pi0.services.radar]\n")
    authority.init(keys, "spotter")
    authority.issue(keys, "pi0", "host", ("127.0.0.1",))
    authority.issue(keys, "guest", "laptop")
    words = [str(Path(sys.executable).with_name("spotter")), "router", "--host", "pi0", "--site", str(file)]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as router:
        yield SimpleNamespace(site=load_site(file), file=file, keys=keys, router=router)
        router.terminate()
        router.communicate()


def test_a_revocation_restarts_the_router_and_counts_at_once(gate: Any, until: Callable[..., None]) -> None:
    """The laptop hears before and nothing after, while the host itself goes on; nobody touches the process."""
    own = open_session(ZenohConfig(connect=(gate.site.hosts["pi0"].loopback,)), give_up_after_s=BUDGET_S)
    guest = open_session(laptop_config(gate.site, "guest", gate.keys, "pi0"), give_up_after_s=BUDGET_S)
    received: dict[str, set[bytes]] = {"own": set(), "guest": set()}
    own.declare_subscriber("pi0/radar/tracks", lambda sample: received["own"].add(sample.payload.to_bytes()))
    guest.declare_subscriber("pi0/radar/tracks", lambda sample: received["guest"].add(sample.payload.to_bytes()))
    speaker = open_session(ZenohConfig(connect=(gate.site.hosts["pi0"].loopback,)), give_up_after_s=BUDGET_S)

    def comes_through(word: bytes, *to: str) -> bool:
        speaker.put("pi0/radar/tracks", word)
        return all(word in received[one] for one in to)

    until(lambda: comes_through(b"before", "own", "guest"))
    authority.revoke(gate.keys, "guest")
    assert gate.router.stderr is not None
    notice = next(line for line in gate.router.stderr if "names of the site have changed" in line)
    assert "starting again" in notice
    assert next(line for line in gate.router.stderr if "listening on" in line)
    until(lambda: comes_through(b"after", "own"))
    for _ in range(50):
        comes_through(b"after")
        list(speaker.get("nobody/answers/this", timeout=0.05))  # a round trip to the router
    assert b"after" not in received["guest"]
    assert gate.router.poll() is None
    for session in (speaker, guest, own):
        close_session(session)


def test_a_router_stays_as_it_is_while_its_files_are_wrong(gate: Any) -> None:
    """Half a register, then a register beside a site.toml with a mistake: a restart would end the whole host."""
    whole = (gate.keys / "names.json").read_bytes()
    assert gate.router.stderr is not None
    assert next(line for line in gate.router.stderr if "listening on" in line)
    (gate.keys / "names.json").write_bytes(whole[:-20])
    assert "the old rules stay" in next(line for line in gate.router.stderr if "names.json" in line)
    gate.file.write_text(gate.file.read_text() + "adress = 3\n")
    (gate.keys / "names.json").write_bytes(whole.replace(b"guest", b"quest"))
    assert "the old rules stay" in next(line for line in gate.router.stderr if "adress" in line)
    assert gate.router.poll() is None
    gate.file.write_text(gate.file.read_text().replace("adress = 3\n", ""))
    assert next(line for line in gate.router.stderr if "starting again with new rules" in line)
