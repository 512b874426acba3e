"""systemd units for one host of the site: one per service, one for the router, and a target that holds them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from common.site import Site
from common.topics import service_row

USER = "spotter"
SYSUSERS = f"# Installed by `spotter install`.\nu {USER} - Spotter /var/lib/spotter\n"
EXIT_WRONG_CONFIG = 2
_ONLY_LOOPBACK = ("IPAddressDeny=any", "IPAddressAllow=localhost")
# Kernel interfaces that no service needs; what is left is checked by `systemd-analyze security`.
_SANDBOX = """\
NoNewPrivileges=yes
CapabilityBoundingSet=
AmbientCapabilities=
ProtectSystem=strict
ProtectHome=yes
PrivateTmp=yes
ProtectKernelTunables=yes
ProtectKernelModules=yes
ProtectKernelLogs=yes
ProtectControlGroups=yes
ProtectClock=yes
ProtectHostname=yes
ProtectProc=invisible
ProcSubset=pid
RestrictNamespaces=yes
RestrictSUIDSGID=yes
RestrictRealtime=yes
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK
LockPersonality=yes
RemoveIPC=yes
UMask=0077
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallFilter=~@privileged @resources"""


_HIDDEN = ("/home", "/root", "/run/user", "/tmp", "/var/tmp")  # by ProtectHome and PrivateTmp


def hidden(*paths: str) -> list[str]:
    """Those of these paths that no unit can see, however readable they are."""
    return [path for path in paths if any(Path(path).is_relative_to(folder) for folder in _HIDDEN)]


@dataclass(frozen=True)
class Needs:
    """What a service needs besides a processor: groups, devices, memory, and whether it talks to the network."""

    groups: tuple[str, ...] = ()
    devices: tuple[str, ...] = ()
    memory: str = "512M"
    network: bool = False


_BY_SCHEME = {
    "spi": Needs(("spi", "gpio"), ("char-spidev", "char-gpiochip")),
    "serial": Needs(("dialout",), ("char-ttyTHS", "char-ttyAMA", "char-ttyUSB", "char-ttyACM", "char-ttyS")),
    "v4l2": Needs(("video",), ("char-video4linux", "char-media")),
    "csi": Needs(("video", "render"), ("char-video4linux", "char-media", "/dev/nvmap", "/dev/nvhost-* rw")),
    "ouster": Needs(network=True),
    "velodyne": Needs(network=True),
}
_MEMORY = {"camera": "1500M", "infra_lidar": "2G"}


def needs_of(service: str, source: str) -> Needs:
    """From the source's scheme; a simulated or recorded source needs nothing."""
    needs = _BY_SCHEME.get(source.partition(":")[0], Needs())
    network = needs.network or service == "dashboard"
    return Needs(needs.groups, needs.devices, _MEMORY.get(service, needs.memory), network)


def units(site: Site, host: str, program: str, site_file: str) -> dict[str, str]:
    """File name -> text of every unit of a host. ``program`` is the installed `spotter` with its full path.

    Raises:
        ConfigError: no such host.
    """
    own = site.host(host)
    start = f"{program} up {host} --site {site_file} --only"
    files = {
        "spotter.target": _target(host),
        "spotter-router.service": _unit("router", host, start, Needs(network=True)),
    }
    for name, place in own.services.items():
        files[f"{service_row(name).script}.service"] = _unit(name, host, start, needs_of(name, place.source))
    return files


def _target(host: str) -> str:
    return f"[Unit]\nDescription=Spotter on {host}\n\n[Install]\nWantedBy=multi-user.target\n"


def _unit(name: str, host: str, start: str, needs: Needs) -> str:
    after = "network-online.target time-sync.target" if name == "router" else "spotter-router.service"
    lines = [
        "[Unit]",
        f"Description=Spotter {name} on {host}",
        f"Wants={'network-online.target' if name == 'router' else 'spotter-router.service'}",
        f"After={after}",  # an order, no requirement: a service waits for its router and survives it
        "PartOf=spotter.target",
        "StartLimitIntervalSec=0",
        "",
        "[Service]",
        "Type=notify",
        "NotifyAccess=main",
        "TimeoutStartSec=infinity",  # ready means the first message; a device may take its time to appear
        "WatchdogSec=30",
        f"ExecStart={start} {name}",
        "Restart=on-failure",
        "RestartSec=1",
        f"RestartPreventExitStatus={EXIT_WRONG_CONFIG}",
        "TimeoutStopSec=5",
        f"User={USER}",
        *([f"SupplementaryGroups={' '.join(needs.groups)}"] if needs.groups else []),
        "StateDirectory=spotter",
        "WorkingDirectory=%S/spotter",  # a relative folder in a service's settings is below it
        "CacheDirectory=spotter",
        "Environment=NUMBA_CACHE_DIR=/var/cache/spotter OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1",
        f"MemoryMax={needs.memory}",
        "TasksMax=128",
        *([f"DeviceAllow={device}" for device in needs.devices] or ["PrivateDevices=yes"]),
        "DevicePolicy=closed",
        *(() if needs.network else _ONLY_LOOPBACK),
        _SANDBOX,
        "",
        "[Install]",
        "WantedBy=spotter.target",
    ]
    return "\n".join(lines) + "\n"
