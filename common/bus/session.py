"""Opens and closes a Zenoh session so that any start order works and the end never blocks."""

from __future__ import annotations

import json
import logging
import os
import re
import ssl
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zenoh

from common.config import ConfigError, ZenohConfig
from common.source_url import HIGHEST_PORT

log = logging.getLogger("zenoh")

WITH_PORT = ("tcp", "tls", "udp", "quic", "ws")
PROTOCOLS = (*WITH_PORT, "unixsock-stream", "unixpipe", "serial", "vsock")
OPEN_ATTEMPT_MS = 500  # open() ignores signals while it waits, so it waits briefly and often
UNDECLARE_ATTEMPTS = 200
UNDECLARE_PAUSE_S = 0.002
CLOSE_BUDGET_S = 0.7  # close() takes 10 s while the network is cut: too long


def zenoh_settings(config: ZenohConfig) -> dict[str, Any]:
    """Our configuration as Zenoh settings by path.

    Raises:
        ConfigError: a part of the TLS triple is missing.
    """
    settings: dict[str, Any] = {
        "mode": config.mode,
        "connect/endpoints": list(config.connect),
        "listen/endpoints": list(config.listen),
        "connect/retry": {
            "period_init_ms": 200,
            "period_max_ms": 1000,
            "period_increase_factor": 1.5,
        },
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": config.mode == "peer",
        "timestamping/enabled": False,  # a host whose clock is 0.5 s behind logs an error for each stamp that it gets
        "transport/link/tx/lease": config.lease_ms,
        "transport/link/tx/keep_alive": 4,
        "transport/shared_memory/enabled": False,
        "transport/link/tx/queue/size/data": 4,  # of 64 kB: raw pieces come in bursts
    }
    if config.namespace:
        settings["namespace"] = config.namespace
    if config.mode == "client":
        settings["connect/timeout_ms"] = OPEN_ATTEMPT_MS
        settings["connect/exit_on_failure"] = True
    else:  # these return at once and keep trying behind the scenes
        settings["connect/timeout_ms"] = -1
        settings["connect/exit_on_failure"] = False
    tls = (config.ca_certificate, config.certificate, config.private_key)
    if any(tls):
        if not all(tls):
            raise ConfigError("[zenoh] ca_certificate, certificate and private_key belong together: set all or none")
        ca, certificate, key = tls
        settings["transport/link/tls"] = {
            "root_ca_certificate": ca,
            "listen_certificate": certificate,
            "listen_private_key": key,
            "connect_certificate": certificate,
            "connect_private_key": key,
            "enable_mtls": True,
            "verify_name_on_connect": True,
        }
    settings.update(config.extra)
    return settings


def nested_settings(config: ZenohConfig) -> dict[str, Any]:
    """The same settings as one nested mapping: what zenohd reads from a file."""
    nested: dict[str, Any] = {}
    for path, value in zenoh_settings(config).items():
        *sections, last = path.split("/")
        place = nested
        for section in sections:
            place = place.setdefault(section, {})
        place[last] = {**value, **place[last]} if isinstance(place.get(last), dict) else value
    return nested


def build(config: ZenohConfig) -> zenoh.Config:
    """The Zenoh configuration; raises ``ConfigError`` with the setting that Zenoh refuses."""
    for endpoint in (*config.connect, *config.listen):
        refuse_malformed(endpoint)
    if config.ca_certificate and config.certificate and config.private_key:
        refuse_unusable(config)
    built = zenoh.Config()
    for path, value in zenoh_settings(config).items():
        try:
            built.insert_json5(path, json.dumps(value))
        except zenoh.ZError as error:
            raise ConfigError(f"[zenoh] {path} = {value!r}: {plain(error)}") from None
    return built


def refuse_malformed(endpoint: str) -> None:
    """Zenoh accepts an endpoint without a port, or of an unknown protocol, and retries without end. Refuse it here.

    Raises:
        ConfigError: the endpoint is wrong; the text says how.
    """
    protocol, slash, address = endpoint.partition("/")
    port = address.partition("?")[0].partition("#")[0].rpartition(":")[2]
    if not slash or protocol not in PROTOCOLS:
        wrong = f"protocols are {', '.join(PROTOCOLS)}"
    elif protocol in WITH_PORT and not port.isdecimal():
        wrong = "its port is missing"
    elif protocol in WITH_PORT and not 1 <= int(port) <= HIGHEST_PORT:
        wrong = f"ports are 1 to {HIGHEST_PORT}"
    else:
        return
    raise ConfigError(f"[zenoh] endpoint {endpoint!r}: expected PROTOCOL/HOST:PORT, e.g. tcp/127.0.0.1:7447; {wrong}")


def refuse_unusable(config: ZenohConfig) -> None:
    """Zenoh treats missing or wrong certificate files like a router that does not answer, and waits. Refuse them here.

    Raises:
        ConfigError: names the file.
    """
    files = {name: getattr(config, name) for name in ("ca_certificate", "certificate", "private_key")}
    for name, path in files.items():
        try:
            Path(path).open("rb").close()
        except OSError as error:
            raise ConfigError(f"[zenoh] {name} = {path!r}: {error.strerror}") from None
    context, setting = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT), f"[zenoh] ca_certificate = {config.ca_certificate!r}"
    try:
        context.load_verify_locations(config.ca_certificate)
        setting = f"[zenoh] certificate = {config.certificate!r}, private_key = {config.private_key!r}"
        context.load_cert_chain(config.certificate, config.private_key, password="")
    except ssl.SSLError:
        key = " and the private key that belongs to it" if "private_key" in setting else ""
        raise ConfigError(f"{setting}: expected a certificate in PEM{key}") from None


def open_session(config: ZenohConfig, *, give_up_after_s: float | None = None) -> zenoh.Session:
    """Open a session; as a client, wait for the router to appear (signals still work).

    Raises:
        ConfigError: settings that Zenoh refuses.
        ConnectionError: no router answered within ``give_up_after_s``.
    """
    built = build(config)
    waited_s = 0.0
    while True:
        try:
            return zenoh.open(built)
        except zenoh.ZError as error:
            if config.mode != "client":
                raise ConfigError(f"[zenoh] cannot open a {config.mode} session: {plain(error)}") from None
            if waited_s == 0.0 and give_up_after_s is None:
                log.info("waiting for a router at %s", ", ".join(config.connect) or "(no endpoint)")
            waited_s += OPEN_ATTEMPT_MS / 1000
            if give_up_after_s is not None and waited_s >= give_up_after_s:
                raise ConnectionError(
                    f"no router answers at {', '.join(config.connect)}; is `spotter router` or `spotter demo` running?"
                ) from None


def undeclare(subscriber: Any) -> None:
    """End a subscription that another thread iterates; retried, because Zenoh refuses while that thread uses it."""
    for _ in range(UNDECLARE_ATTEMPTS):
        try:
            subscriber.undeclare()
            return
        except RuntimeError:  # "Already borrowed"
            time.sleep(UNDECLARE_PAUSE_S)
        except zenoh.ZError:
            return  # the session is closed: so is the subscription


def pass_on_samples(subscriber: Any, take: Callable[[str, bytes], None]) -> None:
    """Give key and payload of every sample that is put to ``take``, until the subscription or the session ends."""
    try:
        for sample in subscriber:
            if sample.kind == zenoh.SampleKind.PUT:
                take(str(sample.key_expr), sample.payload.to_bytes())
    except zenoh.ZError:
        return


def plain(error: zenoh.ZError) -> str:
    """Zenoh's error without its source code locations."""
    return re.split(r" at /|: \[", str(error))[0]


def close_session(session: zenoh.Session) -> bool:
    """Close within a bounded time. False: it did not finish, and the process has to be ended with ``os._exit``."""
    closer = threading.Thread(target=_close_quietly, args=(session,), daemon=True)
    closer.start()
    closer.join(CLOSE_BUDGET_S)
    return not closer.is_alive()


def _close_quietly(session: zenoh.Session) -> None:
    try:
        session.close()
    except zenoh.ZError as error:
        log.debug("close: %s", error)


def init_zenoh_log(default: str | None) -> None:
    """Zenoh logs to stdout, without colours; ``default`` None leaves it silent unless RUST_LOG asks for it."""
    if default is None and not os.environ.get("RUST_LOG"):
        return  # and the colours of our own commands stay
    os.environ.setdefault("NO_COLOR", "1")
    if default is not None:
        zenoh.init_log_from_env_or(default)
    else:
        zenoh.try_init_log_from_env()
