"""Zenoh access rules of one host's router, made from the site and the topics table.

Three kinds of neighbours, each with the least it needs; whatever no rule allows is dropped.

- this host's own services, over plain TCP on loopback: may speak as the services that the site puts on this host;
- the router of another host, known by its certificate: may forward what that host's services publish, and receives
  only what this host's services publish, so no host relays for a third;
- laptops, known by their certificates: may subscribe and query; each may publish that it records, under its own name.

ROS topics stand outside of the site's namespace. Those of the domains in ``[ros2]`` pass between programs on this host;
no other host and no laptop speaks or hears them.

From afar only the questions of a list may be asked, each by the pattern that is in it: a rule allows what it includes,
so ``**`` would reach a command that changes something, and is no question of the list.

Rules see the neighbour, not the author: that is why a host's keys begin with its name, and why each host has its own
certificate.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from common.host.site import Site
from common.security.names import Names
from common.topics import COMMANDS, DATA_TOPICS, RAW_TOPICS, RECORDER, status_topic

SAY = ["put"]
SPEAK = ["put", "reply", "liveliness_token", "declare_queryable"]
LISTEN = ["declare_subscriber", "liveliness_query", "declare_liveliness_subscriber"]
ASK = ["query"]
ANSWERED = ("status", "info", "clock")  # by every service
CHUNK = re.compile(r"[a-z0-9_]+")
SHADOW = "shadow"  # a candidate under comparison publishes under this prefix, received on its own host only


@dataclass
class _Access:
    """Rules, neighbours and which rules hold for whom, as they are collected; see ``access_rules``."""

    rules: list[dict[str, Any]] = field(default_factory=list)
    subjects: list[dict[str, Any]] = field(default_factory=list)
    policies: list[dict[str, Any]] = field(default_factory=list)

    def allow(self, name: str, messages: list[str], keys: list[str], flow: str) -> None:
        """Add a rule, unless there are no keys that it would be about."""
        if keys:
            rule = {"id": name, "messages": messages, "flows": [flow], "permission": "allow", "key_exprs": keys}
            self.rules.append(rule)

    def grant(self, subject: dict[str, Any], *rules: str) -> None:
        """Add a neighbour and the rules that hold for it, of those that were made."""
        made, name = {rule["id"] for rule in self.rules}, subject["id"]
        self.subjects.append(subject)
        self.policies.append({"id": name, "subjects": [name], "rules": [rule for rule in rules if rule in made]})


def access_rules(site: Site, host: str, names: Names) -> dict[str, Any]:
    """The ``access_control`` section of the Zenoh configuration of ``host``'s router."""
    access, recorders = _Access(), laptop_recorders(site, names)
    _shared_rules(access, site, host, list(recorders.values()))
    _grant_local(access, site, host)
    _grant_hosts(access, site, host, names)
    _grant_laptops(access, names, recorders)
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": access.rules,
        "subjects": access.subjects,
        "policies": access.policies,
    }


def _shared_rules(access: _Access, site: Site, host: str, recorders: list[str]) -> None:
    """What holds for neighbours of several kinds."""
    everything = [f"{site.namespace}/**"]
    access.allow("anyone listens", LISTEN, everything, "ingress")
    access.allow("anyone asks", ASK, questions(site), "ingress")
    access.allow("neighbours are asked", LISTEN + ASK, everything, "egress")
    access.allow("hosts hear this host", SPEAK, spoken_keys(site, host), "egress")
    of_the_site = [key for name in site.hosts for key in spoken_keys(site, name)]
    access.allow("laptops hear the site", SPEAK, of_the_site, "egress")
    access.allow("hosts announce recorders", SAY, recorders, "ingress")
    access.allow("recorders are announced", SAY, recorders, "egress")


def _grant_local(access: _Access, site: Site, host: str) -> None:
    """This host's own services, on loopback."""
    everything = [f"{site.namespace}/**"]
    spoken = spoken_keys(site, host) + own_commands(site, host) + spoken_keys(site, host, f"{SHADOW}/")
    access.allow("local speaks", SPEAK, spoken, "ingress")
    access.allow("local asks", ASK, everything, "ingress")
    access.allow("local hears everything", SPEAK, everything, "egress")
    for flow in ("ingress", "egress"):
        access.allow(f"local ros {flow}", SPEAK + LISTEN + ASK, ros_keys(site), flow)
    access.grant(
        {"id": "local", "interfaces": ["lo"], "link_protocols": ["tcp"]},
        "local speaks", "local asks", "anyone listens", "neighbours are asked", "local hears everything",
        "local ros ingress", "local ros egress",
    )  # fmt: skip


def _grant_hosts(access: _Access, site: Site, host: str, names: Names) -> None:
    """The routers of the other hosts that have a certificate and stand in the site."""
    for name, common_name in names.allowed("host").items():
        if name == host or name not in site.hosts:
            continue
        access.allow(f"{name} speaks", SPEAK, spoken_keys(site, name), "ingress")
        access.grant(
            {"id": name, "cert_common_names": [common_name]},
            f"{name} speaks", "anyone listens", "anyone asks", "neighbours are asked", "hosts hear this host",
            "hosts announce recorders", "recorders are announced",
        )  # fmt: skip


def _grant_laptops(access: _Access, names: Names, recorders: dict[str, str]) -> None:
    """Laptops by their certificates; ``recorders``: by name, the key for its recorder's status."""
    for name, common_name in sorted(names.allowed("laptop").items()):
        access.allow(f"{name} records", SAY, [recorders[name]] if name in recorders else [], "ingress")
        access.grant(
            {"id": f"laptop {name}", "cert_common_names": [common_name]},
            "anyone listens", "anyone asks", "laptops hear the site", "recorders are announced", f"{name} records",
        )  # fmt: skip


def spoken_keys(site: Site, host: str, prefix: str = "") -> list[str]:
    """Every key that the services of ``host``, and a recorder there, publish, answer or hold a token on for others.

    ``prefix`` is a chunk above the host's, or empty.
    """
    base, services = f"{site.namespace}/{prefix}{host}", site.host(host).services
    return [f"{base}/{one}/{last}" for one in (*services, *([RECORDER] if services else [])) for last in _lasts(one)]


def ros_keys(site: Site) -> list[str]:
    """Topics, caches (``@adv`` is matched by no wildcard) and tokens of the ROS domains that are let through."""
    return [
        key
        for domain in site.ros2.domains
        for key in (f"{domain}/**", f"{domain}/**/@adv/**", f"@ros2_lv/{domain}/**", f"@ros2_lv/{domain}/**/@adv/**")
    ]


def laptop_recorders(site: Site, names: Names) -> dict[str, str]:
    """By laptop, the one key that it may publish on: the status of its own recorder.

    No token: tokens cannot be limited in their rate, and fusion reacts to every one. A laptop whose name is not a valid
    part of a key, or is a host's name, gets no key.
    """
    laptops = sorted(names.allowed("laptop"))
    return {
        name: f"{site.namespace}/{status_topic(RECORDER).key(name)}"
        for name in laptops
        if CHUNK.fullmatch(name) and name not in site.hosts
    }


def own_commands(site: Site, host: str) -> list[str]:
    """Commands that only ``host``'s own sessions may give to its services: they are not announced to other routers."""
    services = site.host(host).services
    return [
        f"{site.namespace}/{host}/{command.service}/{command.name}"
        for command in COMMANDS
        if not command.from_afar and command.service in services
    ]


def questions(site: Site) -> list[str]:
    """What may be asked from afar, on whichever host."""
    asked = [f"*/{last}" for last in ANSWERED]
    asked += [f"{command.service}/{command.name}" for command in COMMANDS if command.from_afar]
    return [f"{site.namespace}/*/{question}" for question in asked]


def _lasts(service: str) -> Iterable[str]:
    yield from (topic.product for topic in (*DATA_TOPICS, *RAW_TOPICS) if topic.service == service)
    yield from (command.name for command in COMMANDS if command.service == service and command.from_afar)
    yield from (*ANSWERED, "alive/*")
