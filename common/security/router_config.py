"""The Zenoh configuration of a host's router and of a laptop, from the site and its certificates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from msgspec.structs import replace

from common.config import ConfigError, ZenohConfig
from common.host.site import Site
from common.security.names import Names, read_names
from common.security.rules import access_rules, laptop_recorders
from common.topics import DATA_TOPICS

# Limit for the recorder status of a laptop: one status per second of a few hundred bytes.
WORD_HZ = 2.0
WORD_BYTES = 4096


def router_config(site: Site, host: str, keys: Path) -> ZenohConfig:
    """A router that serves this host's services on loopback and links to the routers of the other hosts.

    Each pair of routers is linked once, dialled by the one that the site names later: the other end waits.

    Raises:
        ConfigError: no such host, or its certificate is missing.
    """
    own = site.host(host)
    earlier = list(site.hosts)[: list(site.hosts).index(host)]
    where = f"{'tls' if site.tls.enabled else 'tcp'}/{own.listen or own.address}:{own.port}"
    listen, connect = (own.loopback, where), tuple(site.endpoint(name) for name in earlier)
    extra: dict[str, Any] = {
        "listen/timeout_ms": -1,  # an address that is not there yet at boot is bound when it comes
        "listen/exit_on_failure": False,
    }
    if not site.tls.enabled:
        return ZenohConfig(mode="router", namespace="", listen=listen, connect=connect, extra=extra)
    names = read_names(keys)
    extra["access_control"] = access_rules(site, host, names)
    extra["downsampling"] = _downsampling(site, names)
    extra["low_pass_filter"] = _low_pass(site, names)
    extra["transport/link/tls/close_link_on_expiration"] = True
    return with_certificate(
        ZenohConfig(mode="router", namespace="", listen=listen, connect=connect, extra=extra), keys, host
    )


def laptop_config(site: Site, name: str, keys: Path, host: str) -> ZenohConfig:
    """A client of ``host``'s router under a laptop's certificate.

    Raises:
        ConfigError: no such host, or the certificate is missing.
    """
    config = ZenohConfig(namespace=site.namespace, connect=(site.endpoint(host),))
    return with_certificate(config, keys, name) if site.tls.enabled else config


def with_certificate(config: ZenohConfig, keys: Path, name: str) -> ZenohConfig:
    """The same session under the certificate of a name.

    Raises:
        ConfigError: a file is missing or unreadable, and what to do.
    """
    files = {
        "ca_certificate": keys / "ca.crt",
        "certificate": keys / f"{name}.crt",
        "private_key": keys / f"{name}.key",
    }
    for path in files.values():
        try:
            path.open("rb").close()
        except OSError as error:
            raise ConfigError(
                f"{path}: {error.strerror}; make it with `spotter keys`, or set [tls] enabled = false in site.toml "
                "to let everybody in"
            ) from None
    return replace(config, **{key: str(path) for key, path in files.items()})


def _downsampling(site: Site, names: Names) -> list[dict[str, Any]]:
    """Clouds and pictures leave a host at their nominal rate at most, a laptop's words come in at theirs."""
    bulk = [
        {"key_expr": f"{site.namespace}/{topic.any_host}", "freq": topic.nominal_hz}
        for topic in DATA_TOPICS
        if topic.is_large
    ]
    words = [{"key_expr": key, "freq": WORD_HZ} for key in laptop_recorders(site, names).values()]
    limits = [{"id": "bulk", "flows": ["egress"], "rules": bulk}, {"id": "words", "flows": ["ingress"], "rules": words}]
    return [{"link_protocols": ["tls"], "messages": ["put"], **limit} for limit in limits if limit["rules"]]


def _low_pass(site: Site, names: Names) -> list[dict[str, Any]]:
    """A laptop's words are short."""
    keys = list(laptop_recorders(site, names).values())
    limit = {"id": "words", "link_protocols": ["tls"], "messages": ["put"], "flows": ["ingress"]}
    return [{**limit, "key_exprs": keys, "size_limit": WORD_BYTES}] if keys else []
