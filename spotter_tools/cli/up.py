"""`spotter up HOST`: what one host runs, supervised."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from common.bus.service_app import setup_logging
from common.config import ConfigError
from common.host.process_plan import Plan, children, parse_settings, plan_of, services_of
from common.host.supervisor import Child, Supervisor, run_supervised, write_stderr
from common.topics import ServiceRow
from spotter_tools.cli.connect import Namespace
from spotter_tools.cli.fail import fail
from spotter_tools.cli.site_option import SiteFile, read_site
from spotter_tools.configurations import check_configurations, start_lines
from spotter_tools.sources import refuse_made_up, refuse_without_source


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
    simulated: Annotated[bool, typer.Option("--simulated", help="The same as --sim crossing.")] = False,
    site_file: SiteFile = None,
    only: Annotated[
        str, typer.Option("--only", help="Become just this service (or `router`): for systemd and containers.")
    ] = "",
    namespace: Namespace = "spotter",
) -> None:
    """Start this host's router and services, restart what dies, stop all of them on Ctrl-C."""
    setup_logging("up")
    sim = sim or ("crossing" if simulated else "")
    site = None
    try:
        if site_file is not None:
            site, _ = read_site(site_file)
            rows, plan = site.rows(host), plan_of(site, host, site_file)
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
        if config_dir is not None and not config_dir.is_dir():
            raise ConfigError(f"--config-dir {config_dir}: no such folder")
        checked = [] if only == "router" else [row for row in rows if only in ("", row.name)]
        configurations = check_configurations(checked, plan)
        refuse_without_source(host, configurations)
        if site is not None:
            refuse_made_up(site, host, configurations)
    except ConfigError as error:
        fail(str(error), code=2)
    if only:
        _become(only, children(rows, plan))
    for line in start_lines(configurations):
        write_stderr(f"  {line}\n")
    raise SystemExit(run_supervised(Supervisor(children(rows, plan))))


def _become(name: str, processes: list[Child]) -> NoReturn:
    """Replace this process, so that the parent watches the service itself."""
    for child in processes:
        if child.name == name:
            os.execvpe(child.command[0], child.command, {**os.environ, **(child.environment or {})})
    fail(f"--only {name}: not on this host; it runs {', '.join(child.name for child in processes)}", code=2)


def sim_sources(rows: list[ServiceRow], scenario: str) -> dict[str, str]:
    """The simulated source of every service that has a sensor; nothing without a scenario."""
    if not scenario:
        return {}
    return {row.name: f"sim:{scenario}" for row in rows if row.name not in ("fusion", "dashboard", "blackbox", "gate")}
