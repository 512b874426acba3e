"""`spotter doctor`: what is wrong with this host and its neighbours, and what to do."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from common.cli.connect import AsJson
from common.cli.fail import fail
from common.cli.site_option import SiteFile, read_site
from common.config import ConfigError
from common.doctor.bus import check_bus, check_from_laptop
from common.doctor.certificates import check_certificate
from common.doctor.findings import Finding
from common.doctor.machine import check_machine, check_ports, check_provider, check_services
from common.hosts import children, plan_of
from common.security.names import read_names
from common.session import init_zenoh_log
from common.site import Site

_MARK = {"ok": "ok     ", "warning": "warning", "broken": "BROKEN "}


def doctor(
    host: Annotated[
        str, typer.Argument(help="Which host of the site, or which laptop, this is; without it every host.")
    ] = "",
    site_file: SiteFile = None,
    as_json: AsJson = False,
) -> None:
    """Check configuration, devices, ports, certificates, links, rules, clocks, versions and disk."""
    init_zenoh_log(None)
    site, keys = read_site(site_file)
    try:
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
        if not any(finding.grade == "broken" for finding in own):  # else nobody answers it, and nobody else is to blame
            yield from check_from_laptop(site, host, keys)
        return
    yield from check_services(children(site.rows(host), plan_of(site, host, site_file)))
    yield from check_certificate(site, host, keys)
    yield from check_ports(site, host)
    yield from check_bus(site, host)


def _line(finding: Finding) -> str:
    then = f"\n          -> {finding.do}" if finding.do else ""
    return f"{_MARK[finding.grade]}  {finding.check}: {finding.what}{then}"
