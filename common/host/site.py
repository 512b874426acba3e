"""site.toml: which hosts there are, where they are reached and what they run. Everything else is derived from it.

The default is the whole system on one machine: three routers on loopback, each with ports of its own.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from common.config import ConfigError, Section, load
from common.geodesy import MapOrigin
from common.host import vehicles
from common.path import PathConfig
from common.topics import OPTIONAL_SERVICES, SERVICES, SERVICES_OF_ANY_HOST, ServiceRow, service_row

Port = Annotated[int, Meta(ge=1, le=65535)]
Chunk = Annotated[str, Meta(pattern=r"^[a-z0-9_]+$")]  # one chunk of a key: no `/`, `*`, `@` or space


class TlsConfig(Section, frozen=True, kw_only=True):
    """``enabled = false`` is the open mode: every client may publish anything. It warns at each start."""

    enabled: bool = True
    keys: str = "keys"  # folder with the certificates, relative to site.toml


class Ros2Config(Section, frozen=True, kw_only=True):
    """ROS domains whose topics this site's routers let through, for programs on the same host; none is the default."""

    domains: tuple[Annotated[int, Meta(ge=0, le=232)], ...] = ()


class ServicePlace(Section, frozen=True, kw_only=True):
    """How a host runs one service. A sensor needs ``source``, here or in ``config``; the rest may be empty."""

    source: str = ""  # e.g. "spi:0.0", "serial:/dev/ttyTHS1", "v4l2:0"
    config: str = ""  # TOML file of the service, relative to site.toml
    command: str = ""  # another program that keeps the contract, instead of ours
    set: tuple[str, ...] = ()  # further "section.key=value"


class HostConfig(Section, frozen=True, kw_only=True):
    """One computer. ``address`` is what the others dial: an IP address or a name.

    ``vehicle`` names the vehicle that it rides on; empty is the roadside once any host of the site has a vehicle.
    """

    vehicle: Annotated[str, Meta(pattern=r"^[a-z0-9_]*$")] = ""
    address: str = "127.0.0.1"
    port: Port = 7448  # the other hosts' routers and laptops; TLS
    local_port: Port = 7447  # this host's own services, plain TCP on loopback only
    listen: str = ""  # where to bind, if not on ``address``
    services: dict[Chunk, ServicePlace] = msgspec.field(default_factory=dict)

    @property
    def loopback(self) -> str:
        """The endpoint of this host's router for its own services."""
        return f"tcp/127.0.0.1:{self.local_port}"


def _one_machine() -> dict[str, HostConfig]:
    ports = {"pi0": 7457, "jetson0": 7447, "infra0": 7467}
    hosts = {}
    for host, port in ports.items():
        services = {row.name: ServicePlace() for row in SERVICES if row.host == host}
        hosts[host] = HostConfig(local_port=port, port=port + 1, services=services)
    return hosts


class Site(Section, frozen=True, kw_only=True):
    """The whole site."""

    namespace: Chunk = "spotter"
    accept_simulated: bool = False  # a site for trials: recorded, emulated and simulated data may take part
    tls: TlsConfig = TlsConfig()
    map: MapOrigin | None = None  # the map's origin on the Earth; None: not configured
    ros2: Ros2Config = Ros2Config()
    path: PathConfig | None = None  # outline and brakes of the vehicles; None: as in the services' own files
    paths: dict[Chunk, PathConfig] = msgspec.field(default_factory=dict)  # of single vehicles, by name
    hosts: dict[Chunk, HostConfig] = msgspec.field(default_factory=_one_machine)

    def __post_init__(self) -> None:
        places: dict[tuple[str, int], str] = {}
        for name, host in self.hosts.items():
            for service in host.services:
                try:
                    service_row(service)
                except KeyError as error:
                    raise ValueError(f"[hosts.{name}.services.{service}]: {error.args[0]}") from None
            loopback = host.address if host.address == "127.0.0.1" else f"loopback of {host.address}"
            for key, address in (("port", host.address), ("local_port", loopback)):
                port, where = getattr(host, key), f"[hosts.{name}] {key}"
                taken = places.setdefault((address, port), where)
                if taken != where:
                    raise ValueError(f"{where} = {port}: already used by {taken} on {address}")
        vehicles.check_vehicles(self.hosts)
        for name in self.paths:
            if name not in self.vehicles:
                raise ValueError(f"[paths.{name}]: no such vehicle; known: {', '.join(filter(None, self.vehicles))}")

    def host(self, name: str) -> HostConfig:
        """Raises ``ConfigError`` with the known names."""
        if name not in self.hosts:
            raise ConfigError(f"site: no host {name!r}; known: {', '.join(self.hosts) or 'none'}")
        return self.hosts[name]

    @property
    def vehicles(self) -> tuple[str, ...]:
        """The names of the vehicles; ``("",)`` for a site with one vehicle that has no name."""
        return vehicles.vehicles_of(self.hosts)

    @property
    def roadside_hosts(self) -> tuple[str, ...]:
        """The hosts of no vehicle."""
        return vehicles.roadside_hosts(self.hosts)

    def path_of(self, host: str) -> PathConfig | None:
        """Outline and brakes of the vehicle that this host rides on; None = not in this file."""
        return self.paths.get(self.host(host).vehicle, self.path)

    def vehicle_hosts(self, name: str) -> tuple[str, ...]:
        """The hosts of the vehicle that this host belongs to; none for a host at the roadside."""
        return () if name in self.roadside_hosts else vehicles.hosts_of(self.hosts, self.host(name).vehicle)

    def host_of(self, service: str, among: Iterable[str] | None = None) -> str | None:
        """The first host that runs this service, or None; ``among`` limits the search to these hosts."""
        names = self.hosts if among is None else among
        return next((name for name in names if service in self.hosts[name].services), None)

    def hosts_with(self, service: str) -> tuple[str, ...]:
        """Every host that runs this service."""
        return tuple(name for name, host in self.hosts.items() if service in host.services)

    def rows(self, name: str) -> list[ServiceRow]:
        """The services of a host, in the order of the topics table, each with this host's name."""
        wanted = self.host(name).services
        table = (*SERVICES, *OPTIONAL_SERVICES, *SERVICES_OF_ANY_HOST)
        return [ServiceRow(row.name, name, row.extra) for row in table if row.name in wanted]

    def endpoint(self, name: str) -> str:
        """Where another host or a laptop reaches this host's router."""
        host = self.host(name)
        return f"{'tls' if self.tls.enabled else 'tcp'}/{host.address}:{host.port}"


def load_site(path: Path | None) -> Site:
    """The file, or the default site without one.

    Raises:
        ConfigError: unreadable, unknown key or service, wrong value, one port twice.
    """
    return load(Site, path)


def keys_folder(site: Site, path: Path | None) -> Path:
    """The folder of the certificates; a relative one is beside site.toml."""
    return (path.parent if path else Path()) / site.tls.keys
