"""Checks over the network, with the real keys: links, services, rules, clocks, versions."""

from __future__ import annotations

import importlib.metadata
import queue
import socket
import uuid
from collections.abc import Iterator
from typing import TypeVar

import zenoh

from common import topics
from common.clock import utc_ns
from common.codec import DecodeError, decode
from common.config import ZenohConfig
from common.doctor.findings import Finding, broken, ok
from common.messages import ClockReply, Message, ServiceInfo, SystemHealth
from common.session import close_session, open_session
from common.site import Site

M = TypeVar("M", bound=Message)
ANSWER_S = 1.5
CLOCK_LIMIT_MS = 50.0


def check_bus(site: Site, host: str) -> Iterator[Finding]:
    """As a client of this host's own router: what its services would see."""
    own = site.host(host)
    config = ZenohConfig(namespace=site.namespace, connect=(own.loopback,))
    try:
        session = open_session(config, give_up_after_s=2.0)
    except ConnectionError as error:
        yield broken("own router", str(error), f"start it: spotter up {host}, or systemctl start spotter-router")
        return
    try:
        yield ok("own router", f"answers at {own.loopback}")
        for name in site.hosts:
            if name != host:
                yield _dialled(site, name)
            for service in site.host(name).services:
                yield from _service(session, name, service)
        yield from _seen_by_fusion(session, site, host)
        if site.tls.enabled:
            yield _rules(session, config)
    finally:
        close_session(session)


def _dialled(site: Site, name: str) -> Finding:
    """Can this machine reach the other host's port at all? Tells a network fault from a silent service."""
    other = site.host(name)
    try:
        socket.create_connection((other.address, other.port), timeout=2.0).close()
    except OSError as error:
        do = "check cable, address in site.toml, firewall, and that its router runs"
        return broken(f"reach {name}", f"{other.address}:{other.port}: {error.strerror or error}", do)
    return ok(f"reach {name}", f"{other.address}:{other.port} accepts connections")


def _service(session: zenoh.Session, host: str, service: str) -> Iterator[Finding]:
    """From there to here, on real keys: it answers, speaks our version, and its clock agrees."""
    check = f"hear {host}/{service}"
    info = ask(session, topics.info_key(host, service), ServiceInfo)
    if info is None:
        yield broken(check, "does not answer", f"on {host}: is it running? `spotter doctor` there; is {host} revoked?")
        return
    yield ok(check, f"version {info.version}, instance {info.instance}, config {info.config_hash}")
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
    told = f"{offset_ms:+.1f} ms from ours, within {bound_ms:.1f} ms"
    if abs(offset_ms) - bound_ms > CLOCK_LIMIT_MS:
        yield broken(f"clock {host}/{service}", told, "synchronise both hosts: chrony or PTP")
    else:
        yield ok(f"clock {host}/{service}", told)


def _seen_by_fusion(session: zenoh.Session, site: Site, host: str) -> Iterator[Finding]:
    """From here to there: what the fusion says of this host's services."""
    fusion = site.host_of("fusion")
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
    """Say something that no rule allows; nobody may hear it."""
    listener = open_session(config, give_up_after_s=2.0)
    try:
        key = f"doctor/{uuid.uuid4().hex[:8]}/probe"
        heard = listener.declare_subscriber(key, zenoh.handlers.RingChannel(1))
        session.put(key, b"nobody should hear this")
        list(session.get("*/*/info", timeout=ANSWER_S))  # a round trip: what was to come has come
        arrived = heard.try_recv() is not None
    finally:
        close_session(listener)
    if arrived:
        return broken(
            "access rules", "the router passes on what no rule allows", "start it with `spotter router --host`"
        )
    return ok("access rules", "a key outside the rules was dropped")


def ask(session: zenoh.Session, key: str, kind: type[M], payload: bytes | None = None) -> M | None:
    """The first sensible answer, or None."""
    for reply in session.get(key, payload=payload, timeout=ANSWER_S):
        if reply.ok is None:
            continue
        try:
            return decode(reply.ok.payload.to_bytes(), kind)
        except DecodeError:
            continue
    return None


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
