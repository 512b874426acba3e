"""systemd units for one host of the site: one per service, one for the router, and a target that holds them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from common.host.gpu_devices import gpu_devices
from common.host.site import Site
from common.topics import service_row

USER = "spotter"
SYSUSERS = f"# Installed by `spotter install`.\nu {USER} - Spotter /var/lib/spotter\n"
EXIT_WRONG_CONFIG = 2
CPUINFO = Path("/proc/cpuinfo")
_ONLY_LOOPBACK = ("IPAddressDeny=any", "IPAddressAllow=localhost")
# Kernel interfaces that no service needs; what is left is checked by `systemd-analyze security`.
_SANDBOX = """\
NoNewPrivileges=yes
CapabilityBoundingSet=
AmbientCapabilities=
ProtectSystem=strict
ProtectHome=yes
ProtectKernelTunables=yes
ProtectKernelModules=yes
ProtectKernelLogs=yes
ProtectControlGroups=yes
ProtectClock=yes
ProtectHostname=yes
ProtectProc=invisible
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
    """What a service needs besides a processor: groups, devices, memory, and whether it talks to the network.

    ``sees_tmp``: the Jetson's camera daemon listens below /tmp. ``sees_proc``: a GPU's libraries read /proc/devices and
    the like.
    """

    groups: tuple[str, ...] = ()
    devices: tuple[str, ...] = ()
    memory: str = "512M"
    network: bool = False
    sees_tmp: bool = False
    sees_proc: bool = False


_BY_SCHEME = {
    "spi": Needs(("spi", "gpio"), ("char-spidev", "char-gpiochip")),
    "serial": Needs(("dialout",), ("char-ttyTHS", "char-ttyAMA", "char-ttyUSB", "char-ttyACM", "char-ttyS")),
    "v4l2": Needs(("video",), ("char-video4linux", "char-media")),
    "csi": Needs(("video",), ("char-video4linux", "char-media"), sees_tmp=True),
    "hesai": Needs(network=True),
    "ouster": Needs(network=True),
    "robosense": Needs(network=True),
    "ros2": Needs(network=True),
    "velodyne": Needs(network=True),
}
_MEMORY = {"camera": "1500M", "infra_lidar": "2G"}


def needs_of(service: str, source: str) -> Needs:
    """From the source's scheme; a simulated or recorded source needs nothing. A live camera's network needs the GPU."""
    needs = _BY_SCHEME.get(source.partition(":")[0], Needs())
    if service == "camera" and needs.devices:
        groups, devices = (*needs.groups, "render"), (*needs.devices, *gpu_devices())
        needs = replace(needs, groups=groups, devices=devices, sees_proc=True)
    return replace(needs, memory=_MEMORY.get(service, needs.memory), network=needs.network or service == "dashboard")


def units(site: Site, host: str, program: str, site_file: str) -> dict[str, str]:
    """File name -> text of every unit of a host. ``program`` is the installed `spotter` with its full path.

    Raises:
        ConfigError: no such host.
    """
    own = site.host(host)
    start = f"{program} up {host} --site {site_file} --only"
    where = f"{host} of {own.vehicle}" if own.vehicle else host
    files = {
        "spotter.target": _target(where),
        "spotter-router.service": _unit("router", where, start, Needs(network=True)),
    }
    for name, place in own.services.items():
        files[f"{service_row(name).script}.service"] = _unit(name, where, start, needs_of(name, place.source))
    return files


def _kernel_processor() -> list[str]:
    """With AVX2, kernels are compiled for x86-64-v3: they last when a virtual machine moves to another processor."""
    has_avx2 = CPUINFO.exists() and " avx2 " in CPUINFO.read_text()
    return ["Environment=NUMBA_CPU_NAME=x86-64-v3 NUMBA_CPU_FEATURES="] if has_avx2 else []


def _target(where: str) -> str:
    return f"[Unit]\nDescription=Spotter on {where}\n\n[Install]\nWantedBy=multi-user.target\n"


def _unit(name: str, where: str, start: str, needs: Needs) -> str:
    after = "network-online.target time-sync.target" if name == "router" else "spotter-router.service"
    lines = [
        "[Unit]",
        f"Description=Spotter {name} on {where}",
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
        "Restart=always",  # `systemctl stop` stops it; whatever else ends it does not
        "RestartSec=1",
        f"RestartPreventExitStatus={EXIT_WRONG_CONFIG}",
        "TimeoutStopSec=5",
        f"User={USER}",
        *([f"SupplementaryGroups={' '.join(needs.groups)}"] if needs.groups else []),
        "StateDirectory=spotter",
        "WorkingDirectory=%S/spotter",  # a relative folder in a service's settings is below it
        "CacheDirectory=spotter",
        "Environment=NUMBA_CACHE_DIR=/var/cache/spotter OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1",
        *_kernel_processor(),
        f"MemoryMax={needs.memory}",
        "TasksMax=128",
        *([f"DeviceAllow={device}" for device in needs.devices] or ["PrivateDevices=yes"]),
        "DevicePolicy=closed",
        *(() if needs.network else _ONLY_LOOPBACK),
        *(["PrivateTmp=no", "ReadWritePaths=/tmp"] if needs.sees_tmp else ["PrivateTmp=yes"]),
        *([] if needs.sees_proc else ["ProcSubset=pid"]),
        _SANDBOX,
        "",
        "[Install]",
        "WantedBy=spotter.target",
    ]
    return "\n".join(lines) + "\n"
