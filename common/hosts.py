"""What one host runs: its router and its services, as processes for the supervisor."""

from __future__ import annotations

import json
import os
import re
import shlex
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from common.config import ConfigError
from common.site import Site
from common.supervisor import Child
from common.topics import SERVICES, ServiceRow, service_row


@dataclass(frozen=True)
class Plan:
    """How to start a set of services on this machine.

    ``sources``, ``settings``, ``configs`` and ``commands`` are by service name; ``settings`` are ``section.key=value``
    texts, a command replaces our own program. With ``site_host`` the router is that host's router of the site.
    """

    listen: tuple[str, ...] = ("tcp/127.0.0.1:7447",)
    link: tuple[str, ...] = ()
    namespace: str = "spotter"
    config_dir: Path | None = None
    sources: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    configs: Mapping[str, Path] = field(default_factory=dict)
    commands: Mapping[str, str] = field(default_factory=dict)
    site_host: str = ""
    site_file: Path | None = None


def plan_of(site: Site, host: str, site_file: Path | None) -> Plan:
    """What ``spotter up HOST --site FILE`` runs. A path in site.toml is relative to it.

    Raises:
        ConfigError: no such host.
    """
    own, folder = site.host(host), site_file.parent if site_file else Path()
    return Plan(
        listen=(own.loopback,),
        namespace=site.namespace,
        sources={name: place.source for name, place in own.services.items() if place.source},
        settings={
            name: (*whereabouts(site, name), *map(_with_environment, place.set)) for name, place in own.services.items()
        },
        configs={name: folder / place.config for name, place in own.services.items() if place.config},
        commands={name: place.command for name, place in own.services.items() if place.command},
        site_host=host,
        site_file=site_file,
    )


def _with_environment(setting: str) -> str:
    """``${NAME}`` in a setting comes from the environment, so that a token need not stand in a file."""

    def value(match: re.Match[str]) -> str:
        if match[1] not in os.environ:
            raise ConfigError(f"site: set = {setting!r}: {match[1]} is not in the environment")
        return os.environ[match[1]]

    return re.sub(r"\$\{(\w+)\}", value, setting)


def whereabouts(site: Site, service: str) -> tuple[str, ...]:
    """Settings that tell a service where the site runs the services it listens to."""
    if service == "fusion":
        sensors = {name: site.host_of(name) for name in ("lidar", "radar", "camera", "infra_lidar")}
        told = [f"sensors.{name}.host={host}" for name, host in sensors.items() if host]
        ego = site.host_of("ego")
        return (*told, *([f"ego_host={ego}"] if ego else []))
    if service in ("dashboard", "blackbox"):
        return (f"fusion_host={site.host_of('fusion')}",) if site.host_of("fusion") else ()
    return ()


def services_of(host: str) -> list[ServiceRow]:
    """The rows of the table that this host runs.

    Raises:
        ConfigError: nothing runs on a host of this name.
    """
    rows = [row for row in SERVICES if row.host == host]
    if not rows:
        known = sorted({row.host for row in SERVICES})
        raise ConfigError(f"no services on host {host!r}; known hosts: {', '.join(known)}")
    return rows


def children(rows: list[ServiceRow], plan: Plan) -> list[Child]:
    """The router and one process per service."""
    return [router_child(plan)] + [service_child(row, plan) for row in rows]


def router_child(plan: Plan) -> Child:
    command = [*_script("spotter"), "router"]
    if plan.site_host:
        site = ["--site", str(plan.site_file)] if plan.site_file else []
        return Child("router", [*command, "--host", plan.site_host, *site])
    for endpoint in plan.listen:
        command += ["--listen", endpoint]
    for endpoint in plan.link:
        command += ["--link", endpoint]
    return Child("router", command)


def service_child(row: ServiceRow, plan: Plan) -> Child:
    settings = [
        f"host={row.host}",
        f"zenoh.connect={json.dumps([plan.listen[0]])}",
        f"zenoh.namespace={plan.namespace}",
        *plan.settings.get(row.name, ()),
    ]
    if row.name in plan.commands:
        return Child(row.name, shlex.split(plan.commands[row.name]), environment=_for_strangers(row, plan))
    command = _script(row.script)
    path = plan.configs.get(row.name)
    if path is None and plan.config_dir is not None:
        path = plan.config_dir / f"{row.name}.toml"
    if path is not None and (path.exists() or row.name in plan.configs):
        command += ["--config", str(path)]
    for setting in settings:
        command += ["--set", setting]
    if row.name in plan.sources:
        command += ["--source", plan.sources[row.name]]
    return Child(row.name, command, environment=service_environment())


def parse_settings(texts: list[str]) -> dict[str, tuple[str, ...]]:
    """``radar.cfar.threshold_db=14`` to {"radar": ("cfar.threshold_db=14",)}.

    Raises:
        ConfigError: no service of that name, or not of this form.
    """
    settings: dict[str, tuple[str, ...]] = {}
    for text in texts:
        name, dot, rest = text.partition(".")
        if not dot or "=" not in rest:
            raise ConfigError(f"--set {text!r}: expected SERVICE.section.key=value")
        try:
            service_row(name)
        except KeyError as error:
            raise ConfigError(f"--set {text!r}: {error.args[0]}") from None
        settings[name] = (*settings.get(name, ()), rest)
    return settings


def _script(name: str) -> list[str]:
    """The console script beside this very interpreter, so that no other installation is picked up."""
    return [str(Path(sys.executable).with_name(name))]


def _for_strangers(row: ServiceRow, plan: Plan) -> dict[str, str]:
    """What a program that is not ours needs to know, in its environment."""
    told = {"SPOTTER_HOST": row.host, "SPOTTER_CONNECT": plan.listen[0], "SPOTTER_NAMESPACE": plan.namespace}
    return {**service_environment(), **told}


def service_environment() -> dict[str, str]:
    """One thread for the numeric libraries: each service has its core's share, not the whole machine."""
    one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    return {**one_thread, **os.environ, "PYTHONUNBUFFERED": "1"}
