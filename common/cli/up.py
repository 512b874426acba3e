"""`spotter up HOST`: what one host runs, supervised."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from common.cli.connect import Namespace
from common.cli.fail import fail
from common.cli.site_option import SiteFile, read_site
from common.config import ConfigError
from common.hosts import Plan, children, parse_settings, plan_of, services_of
from common.launch import setup_logging
from common.supervisor import Child, Supervisor, run_supervised
from common.topics import ServiceRow


def up(
    host: Annotated[str, typer.Argument(help="The host's role: pi0, jetson0 or infra0.")],
    listen: Annotated[
        list[str] | None, typer.Option("--listen", help="Endpoints of this host's router; services use the first.")
    ] = None,
    link: Annotated[list[str] | None, typer.Option("--link", help="Routers of other hosts to link to.")] = None,
    config_dir: Annotated[
        Path | None, typer.Option("--config-dir", help="Folder with <service>.toml files, e.g. radar.toml.")
    ] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", help="SERVICE.section.key=value, e.g. radar.cfar.threshold_db=14.")
    ] = None,
    sim: Annotated[str, typer.Option("--sim", help="Feed every sensor from this simulated scenario.")] = "",
    site_file: SiteFile = None,
    only: Annotated[
        str, typer.Option("--only", help="Become just this service (or `router`): for systemd and containers.")
    ] = "",
    namespace: Namespace = "spotter",
) -> None:
    """Start this host's router and services, restart what dies, stop all of them on Ctrl-C."""
    setup_logging("up")
    try:
        if site_file is not None:
            rows, plan = _of_site(host, site_file)
        else:
            rows = services_of(host)
            plan = Plan(listen=tuple(listen or Plan.listen), link=tuple(link or ()), namespace=namespace)
        more = parse_settings(overrides or [])
        plan = replace(
            plan,
            config_dir=config_dir,
            sources={**plan.sources, **sim_sources(rows, sim)},
            settings={row.name: (*plan.settings.get(row.name, ()), *more.get(row.name, ())) for row in rows},
        )
    except ConfigError as error:
        fail(str(error), code=2)
    if config_dir is not None and not config_dir.is_dir():
        fail(f"--config-dir {config_dir}: no such folder", code=2)
    if only:
        _become(only, children(rows, plan))
    raise SystemExit(run_supervised(Supervisor(children(rows, plan))))


def _become(name: str, processes: list[Child]) -> NoReturn:
    """Replace this process, so that whoever started us watches the service itself."""
    for child in processes:
        if child.name == name:
            os.execvpe(child.command[0], child.command, {**os.environ, **(child.environment or {})})
    fail(f"--only {name}: not on this host; it runs {', '.join(child.name for child in processes)}", code=2)


def _of_site(host: str, site_file: Path) -> tuple[list[ServiceRow], Plan]:
    site, _ = read_site(site_file)
    return site.rows(host), plan_of(site, host, site_file)


def sim_sources(rows: list[ServiceRow], scenario: str) -> dict[str, str]:
    """The simulated source of every service that has a sensor; nothing without a scenario."""
    if not scenario:
        return {}
    return {row.name: f"sim:{scenario}" for row in rows if row.name not in ("fusion", "dashboard", "blackbox")}
