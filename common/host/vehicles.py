"""Which host belongs to which vehicle, and what that forbids.

``[hosts.NAME] vehicle = "car0"`` names the vehicle of a host. Where at least one host has this key, the hosts without
it stand at the roadside. Where no host has it, all hosts belong to one vehicle without a name.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from common.topics import ONBOARD_SENSORS

ONE_PER_VEHICLE = (*ONBOARD_SENSORS, "ego", "fusion")


class _Host(Protocol):
    @property
    def vehicle(self) -> str: ...
    @property
    def services(self) -> Mapping[str, object]: ...


Hosts = Mapping[str, _Host]


def vehicles_of(hosts: Hosts) -> tuple[str, ...]:
    """The names of the vehicles in the order of the file; ``("",)`` for the one vehicle of a site without names."""
    return tuple(dict.fromkeys(host.vehicle for host in hosts.values() if host.vehicle)) or ("",)


def hosts_of(hosts: Hosts, vehicle: str) -> tuple[str, ...]:
    """The hosts of one vehicle, in the order of the file."""
    return tuple(name for name, host in hosts.items() if host.vehicle == vehicle)


def roadside_hosts(hosts: Hosts) -> tuple[str, ...]:
    """The hosts that belong to no vehicle; none where no vehicle has a name."""
    return hosts_of(hosts, "") if vehicles_of(hosts) != ("",) else ()


def check_vehicles(hosts: Hosts) -> None:
    """Refuse a site in which a fusion could receive the sensors of another vehicle.

    Raises:
        ValueError: a service of ``ONE_PER_VEHICLE`` on two hosts of a vehicle, or at the roadside.
    """
    for service in ONE_PER_VEHICLE:
        for vehicle in vehicles_of(hosts):
            places = [name for name in hosts_of(hosts, vehicle) if service in hosts[name].services]
            if len(places) > 1:
                raise ValueError(_twice(service, places, vehicle))
        for name in roadside_hosts(hosts):
            if service in hosts[name].services:
                allowed = ", ".join(vehicles_of(hosts))
                raise ValueError(
                    f"[hosts.{name}] vehicle = '': {name} runs {service}, which belongs to a vehicle; "
                    f"allowed: {allowed}, or a new name"
                )


def _twice(service: str, places: list[str], vehicle: str) -> str:
    first, second = places[:2]
    which = f"vehicle {vehicle!r}" if vehicle else "a site without vehicle names"
    return (
        f"[hosts.{second}.services.{service}]: {first} runs {service} too, and {which} may have one; "
        f'give each vehicle\'s hosts a name of their own, e.g. [hosts.{second}] vehicle = "car1"'
    )
