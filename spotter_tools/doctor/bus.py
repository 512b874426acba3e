"""Checks over the network, with the real keys: links, services, rules, clocks, versions."""

from __future__ import annotations

import importlib.metadata
import queue
import socket
import threading
import uuid
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TypeVar

import zenoh

from common import topics
from common.bus.session import close_session, open_session, undeclare
from common.clock import WRONG_CLOCK_S, clock_words, utc_ns
from common.codec import DecodeError, decode, encoding_of
from common.config import ConfigError, ZenohConfig
from common.host.site import Site
from common.messages import ClockReply, LinkFault, Message, RouterLinks, ServiceInfo, SystemHealth
from common.security.router_config import laptop_config
from spotter_tools.doctor.findings import Finding, broken, ok, warning
from spotter_tools.doctor.link_faults import OwnFiles, link_fault

M = TypeVar("M", bound=Message)
ANSWER_S = 1.5
OPEN_S = 2.0
PROBES, PROBE_S = 10, 0.1
CLOCK_LIMIT_MS = 50.0


def alive_on(site: Site, host: str) -> set[str]:
    """The services of this host that are alive, as its own router knows them; none when no router answers."""
    config = ZenohConfig(namespace=site.namespace, connect=(site.host(host).loopback,))
    try:
        session = open_session(config, give_up_after_s=OPEN_S / 4)
    except ConnectionError:
        return set()
    try:
        replies = session.liveliness().get(topics.token_key(host, "*", "*"), timeout=ANSWER_S)
        return {topics.parse_token(str(reply.ok.key_expr))[1] for reply in replies if reply.ok is not None}
    finally:
        close_session(session)


def check_bus(site: Site, host: str) -> Iterator[Finding]:
    """As a client of this host's own router, as its services are."""
    own = site.host(host)
    config = ZenohConfig(namespace=site.namespace, connect=(own.loopback,))
    try:
        session = open_session(config, give_up_after_s=OPEN_S)
    except ConnectionError as error:
        yield broken("own router", str(error), f"start it: spotter up {host}, or systemctl start spotter-router")
        return
    try:
        yield ok("own router", f"answers at {own.loopback}")
        links = ask(session, topics.links_key(host), RouterLinks)
        for name in site.hosts:
            if name != host:
                yield _dialled(site, name)
            if links is not None and name in links.faults:
                yield _unlinked(f"link {name}", links.faults[name])
            yield from check_services_of(session, name, site.host(name).services)
        yield from _seen_by_fusion(session, site, host)
        if site.tls.enabled:
            yield _rules(session, config)
    finally:
        close_session(session)


def check_from_laptop(site: Site, name: str, keys: Path) -> Iterator[Finding]:
    """As a laptop, at the router of each host: is it admitted, and does it receive that host's messages?"""
    for host in site.hosts:
        dialled = _dialled(site, host)
        yield dialled
        if dialled.grade == "broken":
            continue
        try:
            config = laptop_config(site, name, keys, host)
            session = open_session(config, give_up_after_s=OPEN_S)
        except ConfigError as error:
            yield broken(f"enter {host}", str(error), "copy its certificate, its key and ca.crt here")
            continue
        except ConnectionError as error:
            own = OwnFiles(keys / "ca.crt", keys / f"{name}.crt", keys / f"{name}.key", "laptop")
            other = site.host(host)
            fault = link_fault(own, host, other.address, other.port) if site.tls.enabled else None
            do = f"is the certificate of {name} of this site and in date, and the clock right?"
            yield _unlinked(f"enter {host}", fault) if fault else broken(f"enter {host}", str(error), do)
            continue
        try:
            yield ok(f"enter {host}", f"its router takes {name}")
            yield from check_services_of(session, host, site.host(host).services)
            if site.tls.enabled:
                yield _rules(session, config)
        finally:
            close_session(session)


def _dialled(site: Site, name: str) -> Finding:
    """Can this machine reach the other host's port at all? Distinguishes a network fault from a silent service."""
    other = site.host(name)
    try:
        socket.create_connection((other.address, other.port), timeout=2.0).close()
    except OSError as error:
        do = "check cable, address in site.toml, firewall, and that its router runs"
        return broken(f"reach {name}", f"{other.address}:{other.port}: {error.strerror or error}", do)
    return ok(f"reach {name}", f"{other.address}:{other.port} accepts connections")


def _unlinked(check: str, fault: LinkFault) -> Finding:
    """Names the clock if that is the reason: a new certificate would not help then."""
    on_clock = "set the clock (chrony); the certificates are in order"
    return broken(check, fault.why, on_clock if fault.cause == "clock" else "see the reason")


def check_services_of(session: zenoh.Session, host: str, services: Iterable[str]) -> Iterator[Finding]:
    """Every service of a host answers and its periodic topics arrive here."""
    for service in services:
        yield from _service(session, host, service)
    topics_of_host = [t for t in topics.DATA_TOPICS if t.service in services and not t.on_demand]
    samples = first_messages(session, [topic.key(host) for topic in topics_of_host])
    for topic in topics_of_host:
        yield _topic(topic, topic.key(host), samples.get(topic.key(host)))


def _topic(topic: topics.Topic, key: str, sample: zenoh.Sample | None) -> Finding:
    """From there to here, with the data itself: it arrives and can be decoded."""
    if sample is None:
        silence = f"nothing within {ANSWER_S:g} s"
        if topic.age_limit_s is None:
            return warning(f"hear {key}", silence, "nobody decides by it; is it switched off in its configuration?")
        return broken(f"hear {key}", silence, "`spotter health` says what its service lacks")
    theirs, ours = str(sample.encoding), str(encoding_of(topic.message))
    try:
        decode(sample.payload.to_bytes(), topic.message, topic.max_bytes)
    except DecodeError as error:
        return broken(f"schema {key}", f"{theirs}: {error}", f"we read {ours}: one version on all hosts")
    if theirs != ours:
        return broken(f"schema {key}", f"its encoding is {theirs}", f"we read {ours}: one version on all hosts")
    return ok(f"hear {key}", f"{len(sample.payload)} bytes, {theirs.partition(';')[2]}")


def _service(session: zenoh.Session, host: str, service: str) -> Iterator[Finding]:
    """From there to here, on real keys: it answers, has our version, and its clock agrees."""
    check = f"hear {host}/{service}"
    info = ask(session, topics.info_key(host, service), ServiceInfo)
    if info is None:
        yield broken(check, "does not answer", f"on {host}: is it running? `spotter doctor` there; is {host} revoked?")
        return
    origin = f", source {info.source} ({info.source_kind})" if info.source else ""
    yield ok(check, f"version {info.version}, instance {info.instance}, config {info.config_hash}{origin}")
    ours = importlib.metadata.version("spotter")
    if info.version != ours:
        yield broken(f"version {host}/{service}", f"{info.version}, here {ours}", "one version is one wire format")
    yield from _clock(session, host, service)


def _clock(session: zenoh.Session, host: str, service: str) -> Iterator[Finding]:
    asked_ns = utc_ns()
    reply = ask(session, topics.clock_key(host, service), ClockReply, asked_ns.to_bytes(8, "little"))
    back_ns = utc_ns()
    if reply is None or reply.stamp_ns != asked_ns:
        return
    there_ns = (reply.request_received_ns + reply.reply_sent_ns) / 2
    offset_ms = (there_ns - (asked_ns + back_ns) / 2) * 1e-6
    bound_ms = (back_ns - asked_ns) * 0.5e-6
    offset = f"{offset_ms:+.1f} ms from ours, within {bound_ms:.1f} ms"
    if abs(offset_ms) > WRONG_CLOCK_S * 1e3:
        words = clock_words(host, offset_ms / 1e3)
        yield broken(f"clock {host}/{service}", f"{words}, as seen from here", "set the clock that is wrong (chrony)")
    elif abs(offset_ms) - bound_ms > CLOCK_LIMIT_MS:
        yield broken(f"clock {host}/{service}", offset, "synchronise both hosts: chrony or PTP")
    else:
        yield ok(f"clock {host}/{service}", offset)


def _seen_by_fusion(session: zenoh.Session, site: Site, host: str) -> Iterator[Finding]:
    """From here to there: what the own vehicle's fusion says of this host's services; of a roadside host, the first."""
    fusion = site.host_of("fusion", site.vehicle_hosts(host) or None)
    if fusion is None:
        return
    health = next_message(session, topics.FUSION_HEALTH.key(fusion), SystemHealth)
    if health is None:
        yield broken(f"hear {fusion}/fusion/health", "no health message", f"look at fusion on {fusion}")
        return
    for service in site.host(host).services:
        sensor = health.sensors.get(service)
        if sensor is None:
            continue
        check = f"seen by {fusion}: {service}"
        if sensor.state == "online":
            yield ok(check, f"online, {sensor.rate_hz:.1f} Hz")
        else:
            yield broken(
                check, f"{sensor.state}: {sensor.reason}", "see the reason; `spotter health` shows all sensors"
            )


def _rules(session: zenoh.Session, config: ZenohConfig) -> Finding:
    """Publish what no rule allows; no subscriber may receive it."""
    listener, arrived = open_session(config, give_up_after_s=OPEN_S), threading.Event()
    try:
        key = f"doctor/{uuid.uuid4().hex[:8]}/probe"
        kept = listener.declare_subscriber(key, lambda _: arrived.set())
        for _ in range(PROBES):  # the first ones may come before the router knows the subscriber
            session.put(key, b"nobody should hear this")
            if arrived.wait(PROBE_S):
                break
        undeclare(kept)
    finally:
        close_session(listener)
    if arrived.is_set():
        return broken(
            "access rules", "the router passes on what no rule allows", "start it with `spotter router --host`"
        )
    return ok("access rules", "a key outside the rules was dropped")


def ask(session: zenoh.Session, key: str, kind: type[M], payload: bytes | None = None) -> M | None:
    """The first valid answer, or None."""
    for reply in session.get(key, payload=payload, timeout=ANSWER_S):
        if reply.ok is None:
            continue
        try:
            return decode(reply.ok.payload.to_bytes(), kind)
        except DecodeError:
            continue
    return None


def first_messages(session: zenoh.Session, keys: list[str]) -> dict[str, zenoh.Sample]:
    """The next message on each of these keys; without those that were silent for the budget."""
    samples: dict[str, zenoh.Sample] = {}
    complete = threading.Event()

    def note(sample: zenoh.Sample) -> None:
        samples.setdefault(str(sample.key_expr), sample)
        if len(samples) == len(keys):
            complete.set()

    subscribers = [session.declare_subscriber(key, note) for key in keys]
    if keys:
        complete.wait(ANSWER_S)
    for subscriber in subscribers:
        undeclare(subscriber)
    return samples


def next_message(session: zenoh.Session, key: str, kind: type[M]) -> M | None:
    """The next message on a key, or None within the budget."""
    inbox: queue.Queue[bytes] = queue.Queue()
    subscriber = session.declare_subscriber(key, lambda sample: inbox.put(sample.payload.to_bytes()))
    try:
        return decode(inbox.get(timeout=ANSWER_S), kind)
    except (queue.Empty, DecodeError):
        return None
    finally:
        subscriber.undeclare()
