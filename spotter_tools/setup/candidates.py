"""What on this machine could be a sensor: paths that stay the same when something else is plugged in come first."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable
from pathlib import Path

from common.config import ConfigError
from spotter_tools.doctor.devices import ARGUS_SOCKET, is_terminal

PORTS = ("ttyUSB*", "ttyACM*", "ttyTHS*", "ttyAMA*")
VIDEO = (".mp4", ".mkv", ".avi", ".mov", ".mjpeg")
LIDAR_PORTS = (2368, 7502, 6699)  # Velodyne's and Hesai's, Ouster's, RoboSense's own
LISTEN_S = 1.5


def lidar(dev: Path) -> list[str]:
    """Serial ports: by the name of the adapter, then by number."""
    return [f"serial:{path}" for path in _stable(dev, "serial/by-id", PORTS) if is_terminal(path)]


def camera(dev: Path) -> list[str]:
    """The CSI port where the Jetson's camera daemon runs, then USB cameras; a video file in their place is played."""
    found = ["csi:0"] if ARGUS_SOCKET.exists() else []
    for path in _stable(dev, "v4l/by-id", ("video*",)):
        if path.resolve().suffix.lower() in VIDEO:
            found.append(f"file:{path.resolve()}?loop=1")
        elif path.is_char_device() and not path.name.endswith(("index1", "index2", "index3")):  # metadata nodes
            found.append(f"v4l2:{path}")
    return found


def radar(dev: Path) -> list[str]:
    """SPI devices."""
    return [f"spi:{path.name.removeprefix('spidev')}" for path in sorted(dev.glob("spidev*"))]


def infra_lidar(dev: Path) -> list[str]:
    """The supported sensors that send packets to this machine; `spotter-infra-lidar look PORT` names the others too."""
    from services.infra_lidar.input.senders import listen, source_of
    from services.infra_lidar.input.sensors import Sender, model_of

    found = []
    for port in LIDAR_PORTS:
        with contextlib.suppress(ConfigError):  # the port is taken: its service runs
            senders = {Sender(one.sender, port, model_of(one.payload)) for one in listen(port, LISTEN_S)}
            found += [source_of(sender, None) for sender in sorted(senders) if sender.supported]
    return found


CANDIDATES: dict[str, Callable[[Path], list[str]]] = {
    "lidar": lidar,
    "camera": camera,
    "radar": radar,
    "infra_lidar": infra_lidar,
}


def own_address() -> str:
    """The address under which other hosts of the network see this machine; loopback without a network."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # a documentation address: nothing is sent by connecting
            return str(probe.getsockname()[0])
        except OSError:
            return "127.0.0.1"


def _stable(dev: Path, by_id: str, patterns: tuple[str, ...]) -> list[Path]:
    """Links by name, then the devices that no link points at."""
    links = sorted((dev / by_id).glob("*")) if (dev / by_id).is_dir() else []
    taken = {link.resolve() for link in links}
    plain = [path for pattern in patterns for path in sorted(dev.glob(pattern)) if path.resolve() not in taken]
    return [*links, *plain]
