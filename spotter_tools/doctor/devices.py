"""The device files and programs behind a source: there, of the right kind, usable by this user. Nothing is read."""

from __future__ import annotations

import grp
import importlib.util
import os
import shutil
import stat
import termios
from collections.abc import Iterator
from pathlib import Path

from spotter_tools.doctor.findings import Finding, broken, ok

ARGUS_SOCKET = Path("/tmp/argus_socket")  # where the Jetson's camera daemon listens
SERIAL = ("serial", "vesc")
_LIBRARIES = {
    "spi": ("spidev", "gpiod"), "serial": ("serial",), "vesc": ("serial",), "gpio": ("gpiod",), "can": ("can",),
    "imu": ("smbus2",), "ros2": ("rosbags",),
}  # fmt: skip
_PROGRAMS = {"v4l2": "gst-launch-1.0", "csi": "gst-launch-1.0"}
_MISSING = {
    "serial": "is the cable in? `ls -l /dev/serial/by-id` shows what is; is the header's UART enabled?",
    "v4l2": "is the camera in? `v4l2-ctl --list-devices` shows what is plugged in",
    "spi": "enable SPI: dtparam=spi=on in /boot/firmware/config.txt, then restart",
}


def device_of(source: str) -> Path | None:
    """The device file that the service will open; None for a source without one."""
    scheme, _, rest = source.partition(":")
    target = rest.partition("?")[0].removeprefix("//")
    if scheme in SERIAL:
        return Path(target)
    if scheme == "v4l2":
        return Path(f"/dev/video{target}" if target.isdigit() else target)
    if scheme == "spi" and target[:1].isdigit():
        return Path(f"/dev/spidev{target}")
    return None


def check_device(service: str, source: str, own_command: tuple[str, ...] = ()) -> Iterator[Finding]:
    """The device file is there, is what the source says it is, and may be used by this user.

    ``own_command``: a camera's capture command from the configuration; the devices that it opens are not checked.
    """
    path, check, scheme = device_of(source), f"{service} device", source.partition(":")[0]
    if own_command:
        return
    if path is None:
        if scheme == "csi" and not ARGUS_SOCKET.exists():
            yield broken(
                check, f"{ARGUS_SOCKET} is not there", "start the camera daemon: systemctl start nvargus-daemon"
            )
        return
    if not path.exists():
        yield broken(check, f"{path} is not there", _MISSING["serial" if scheme in SERIAL else scheme])
    elif not os.access(path, os.R_OK | os.W_OK):
        yield broken(check, f"{path} may not be used by this user", _into_the_group(path.stat().st_gid))
    elif scheme in SERIAL and not is_terminal(path):
        yield broken(
            check, f"{path} is no serial port", 'source = "serial:/dev/serial/by-id/..." or "serial:/dev/ttyTHS1"'
        )
    elif scheme not in SERIAL and not stat.S_ISCHR(path.stat().st_mode):
        yield broken(check, f"{path} is no device", "correct the source")
    else:
        yield ok(check, f"{path} is there and usable")


def _into_the_group(gid: int) -> str:
    """A container knows the groups of its host by their numbers only."""
    try:
        return f"add it to the group: usermod -aG {grp.getgrgid(gid).gr_name} $USER"
    except KeyError:
        return f"its group {gid} has no name here; in a container: group_add {gid}"


def check_model(service: str, model: str) -> Iterator[Finding]:
    """The network's file is there; whether it fits is seen when the service's own program loads it."""
    if model and not Path(model).expanduser().is_file():
        yield broken(f"{service} model", f"{model} is not there", "correct [detector] model, or copy the file there")


def is_terminal(path: Path) -> bool:
    """Whether the device has terminal settings, as every serial port has; opening it does not wait for a carrier."""
    try:
        port = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError:
        return path.is_char_device()  # held by its service: then it was one
    try:
        termios.tcgetattr(port)
    except termios.error:
        return False
    finally:
        os.close(port)
    return True


def check_tools(service: str, source: str, own_command: tuple[str, ...] = ()) -> Iterator[Finding]:
    """The libraries and programs that a source of this scheme needs are installed."""
    scheme = source.partition(":")[0]
    if scheme == "spi" and device_of(source) is None:  # the emulator
        return
    for name in _LIBRARIES.get(scheme, ()):
        if importlib.util.find_spec(name) is None:
            yield broken(
                f"{service} library",
                f"{name} is not installed",
                "install this host's extra (radar-hw for SPI, vehicle for gpio, can, imu; ros2)",
            )
    program = own_command[0] if own_command else _PROGRAMS.get(scheme)
    if program and shutil.which(program) is None:
        do = (
            "apt install gstreamer1.0-tools gstreamer1.0-plugins-base gstreamer1.0-plugins-good, or [capture] a command"
        )
        yield broken(f"{service} program", f"{program} is not installed", do)
