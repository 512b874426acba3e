"""`spotter doctor`: what is wrong with this host and its neighbours, and what to do."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, NoReturn

import msgspec
import typer

from common.bus.namespace import DEMO
from common.bus.session import init_zenoh_log
from common.config import ConfigError
from common.host.process_plan import children, plan_of
from common.host.site import Site
from common.security.names import read_names
from spotter_tools.cli.connect import DEFAULT_ENDPOINT, AsJson, Connect, Namespace
from spotter_tools.cli.fail import fail
from spotter_tools.cli.site_option import SiteFile, read_site
from spotter_tools.doctor.bus import alive_on, check_bus, check_from_laptop
from spotter_tools.doctor.certificates import check_certificate
from spotter_tools.doctor.demo import check_demo
from spotter_tools.doctor.findings import Finding
from spotter_tools.doctor.machine import check_machine, check_ports, check_provider
from spotter_tools.doctor.services import LOOKS, check_services

_MARK = {"ok": "ok     ", "warning": "warning", "broken": "BROKEN "}


def doctor(
    host: Annotated[
        str, typer.Argument(help="Which host of the site, or which laptop, this is; without it every host.")
    ] = "",
    site_file: SiteFile = None,
    connect: Connect = DEFAULT_ENDPOINT,
    namespace: Namespace = "",
    watch: Annotated[
        str, typer.Option("--watch", help="Only show what this sensor shows, again and again: lidar, radar, camera ...")
    ] = "",
    as_json: AsJson = False,
) -> None:
    """Check configuration, devices, ports, certificates, links, rules, clocks, versions and disk.

    Each sensor whose service does not run is opened for a second, as its service would, to see whether data come.
    Without --site and HOST, a demo that runs on this machine (--connect) is checked as a demo.
    """
    init_zenoh_log(None)
    site, keys = read_site(site_file)
    try:
        if watch:
            _watch(site, host, site_file, watch)
        found = check_demo(site, connect, namespace or DEMO) if not host and site_file is None else []
        if not found:
            names = [host] if host else list(site.hosts)
            found = [finding for name in names for finding in _examine(site, name, keys, site_file)]
    except ConfigError as error:
        fail(str(error), code=2)
    found += [*check_machine(Path()), *check_provider()]
    for finding in found:
        print(msgspec.json.encode(finding).decode() if as_json else _line(finding))
    raise SystemExit(1 if any(finding.grade == "broken" for finding in found) else 0)


def _examine(site: Site, host: str, keys: Path, site_file: Path | None) -> Iterator[Finding]:
    if host not in site.hosts and host in read_names(keys).names:  # a laptop
        own = [*check_certificate(site, host, keys)]
        yield from own
        if not any(finding.grade == "broken" for finding in own):  # else every query would fail
            yield from check_from_laptop(site, host, keys)
        return
    processes = children(site.rows(host), plan_of(site, host, site_file))
    yield from check_services(processes, site, alive_on(site, host))
    yield from check_certificate(site, host, keys)
    yield from check_ports(site, host)
    yield from check_bus(site, host)


def _watch(site: Site, host: str, site_file: Path | None, service: str) -> NoReturn:
    """Become the service's own ``look --watch``, with the configuration that `spotter up` would give it."""
    places = [host] if host else site.hosts_with(service)
    if len(places) != 1 or service not in site.host(places[0]).services or service not in LOOKS:
        known = ", ".join(
            f"{place} {name}" for place in site.hosts for name in site.host(place).services if name in LOOKS
        )
        raise ConfigError(
            f"--watch {service}: which one? `spotter doctor HOST --watch SENSOR`; known: {known or 'none'}"
        )
    if service in alive_on(site, places[0]):
        raise ConfigError(
            f"--watch {service}: its service runs and has the device; stop it first, or see `spotter health --watch`"
        )
    (child,) = [
        one for one in children(site.rows(places[0]), plan_of(site, places[0], site_file)) if one.name == service
    ]
    environment = {**os.environ, **(child.environment or {})}
    os.execvpe(child.command[0], [*child.command, "look", "--watch"], environment)


def _line(finding: Finding) -> str:
    then = f"\n          -> {finding.do}" if finding.do else ""
    return f"{_MARK[finding.grade]}  {finding.check}: {finding.what}{then}"
