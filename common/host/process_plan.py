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

import msgspec

from common.config import ConfigError
from common.host.site import Site
from common.host.supervisor import Child
from common.topics import ONBOARD_SENSORS, SENSOR_TOPICS, SERVICES, ServiceRow, service_row

SENSORS_WITH_PATH = ("radar", "lidar", "camera")  # services that need the vehicle's path to evaluate what they measure
SERVICES_WITH_PATH = (*SENSORS_WITH_PATH, "fusion")


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
            name: (
                *sensor_host_settings(site, host, name),
                *path_settings(site, host, name),
                *map(_with_environment, place.set),
                *membership(site, host, name),
            )
            for name, place in own.services.items()
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


def sensor_host_settings(site: Site, host: str, service: str) -> tuple[str, ...]:
    """Settings that name the hosts of the services that a service of ``host`` subscribes to.

    Fusion and what shows it listen to their own vehicle. A sensor that vehicle and roadside lack is not expected, and
    looked for on fusion's own host, where it never appears, so that no other vehicle's sensor takes its place.

    Raises:
        ConfigError: a roadside host that would have to choose between the verdicts of several vehicles.
    """
    own, roadside = site.vehicle_hosts(host), site.roadside_hosts
    if service == "fusion":
        places = {
            name: site.host_of(name, own if name in ONBOARD_SENSORS else (*own, *roadside)) for name in SENSOR_TOPICS
        }
        ego = site.host_of("ego", own) or host
        expects = [f"{place}/{name}" for name in ("ego", "gate") if (place := site.host_of(name, own))]
        return (
            *(f"sensors.{name}.host={place or host}" for name, place in places.items()),
            *(f"sensors.{name}.expected=false" for name, place in places.items() if not place),
            f"ego_host={ego}",
            f"expects={json.dumps(expects)}",
            "store=fusion-memory",
        )
    if service in SENSORS_WITH_PATH:
        return (f"ego_host={site.host_of('ego', own) or host}",)
    if service == "dashboard":
        names = sorted({*site.hosts, *(place.address for place in site.hosts.values())})
        fusion = _whose_verdict(site, host, service)
        others = _other_hosts(site, fusion or host)
        hosts = (f"server.site_hosts={json.dumps(names)}", f"other_hosts={json.dumps(others)}")
        return (*_named(fusion), *hosts, *map_settings(site))
    if service in ("blackbox", "gate"):
        return _named(_whose_verdict(site, host, service))
    return ()


def path_settings(site: Site, host: str, service: str) -> tuple[str, ...]:
    """Settings with width and brakes of the vehicle for a service on board, from the site file."""
    path = site.path_of(host)
    if path is None or service not in SERVICES_WITH_PATH:
        return ()
    return tuple(f"path.{key}={value}" for key, value in msgspec.to_builtins(path).items())


def map_settings(site: Site) -> tuple[str, ...]:
    """The setting with the map's origin on the Earth; one setting, because its keys need each other."""
    if site.map is None:
        return ()
    keys = ", ".join(f"{key} = {value}" for key, value in msgspec.to_builtins(site.map).items())
    return (f"map={{{keys}}}",)


def _named(fusion: str | None) -> tuple[str, ...]:
    return (f"fusion_host={fusion}",) if fusion else ()


def _whose_verdict(site: Site, host: str, service: str) -> str | None:
    """The fusion of the host's own vehicle; at the roadside the only one there is, or the one in ``set``."""
    chosen = [one.partition("=")[2] for one in site.hosts[host].services[service].set if one.startswith("fusion_host=")]
    if chosen:
        return chosen[-1] if chosen[-1] in site.hosts else None
    fusions = [name for name in site.vehicle_hosts(host) or site.hosts if "fusion" in site.hosts[name].services]
    if len(fusions) > 1:
        raise ConfigError(
            f"site: [hosts.{host}.services.{service}] set: no fusion_host, and {host} belongs to no vehicle; "
            f"allowed: {', '.join(f'fusion_host={name}' for name in fusions)}"
        )
    return fusions[0] if fusions else None


def membership(site: Site, host: str, service: str) -> tuple[str, ...]:
    """Settings with the hosts that fusion may use. They come last, so that no other setting overrides them."""
    if service != "fusion":
        return ()
    own, roadside = site.vehicle_hosts(host), site.roadside_hosts
    return (
        f"vehicle.name={json.dumps(site.host(host).vehicle)}",
        f"vehicle.hosts={json.dumps(own)}",
        f"vehicle.roadside_hosts={json.dumps(roadside)}",
        f"vehicle.other_hosts={json.dumps(_other_hosts(site, host))}",
        f"vehicle.live_only={json.dumps(not site.accept_simulated)}",
    )


def _other_hosts(site: Site, host: str) -> list[str]:
    """The hosts of other vehicles than that of ``host``."""
    known = (*site.vehicle_hosts(host), *site.roadside_hosts)
    return [name for name in site.hosts if name not in known]


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
    """The router's process: the site's when the plan has a site host, else one of its own endpoints."""
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
    """A service's process: its script with configuration, settings and source, or the command that replaces it."""
    if row.name in plan.commands:
        return Child(row.name, shlex.split(plan.commands[row.name]), environment=_for_strangers(row, plan))
    command = _script(row.script)
    path, settings = configuration_of(row, plan)
    if path is not None:
        command += ["--config", str(path)]
    for setting in settings:
        command += ["--set", setting]
    if row.name in plan.sources:
        command += ["--source", plan.sources[row.name]]
    return Child(row.name, command, environment=service_environment())


def configuration_of(row: ServiceRow, plan: Plan) -> tuple[Path | None, tuple[str, ...]]:
    """The file (None = the defaults) and the ``section.key=value`` settings of one service, but for its source."""
    path = plan.configs.get(row.name)
    if path is None and plan.config_dir is not None:
        path = plan.config_dir / f"{row.name}.toml"
        path = path if path.exists() else None
    reach = (f"host={row.host}", f"zenoh.connect={json.dumps([plan.listen[0]])}", f"zenoh.namespace={plan.namespace}")
    return path, (*reach, *plan.settings.get(row.name, ()))


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
    variables = {"SPOTTER_HOST": row.host, "SPOTTER_CONNECT": plan.listen[0], "SPOTTER_NAMESPACE": plan.namespace}
    return {**service_environment(), **variables}


def service_environment() -> dict[str, str]:
    """One thread for the numeric libraries: each service has its core's share, not the whole machine."""
    one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    return {**one_thread, **os.environ, "PYTHONUNBUFFERED": "1"}
