"""Checks of this host alone: ports, disk, clock, versions, provider."""

from __future__ import annotations

import ctypes
import importlib
import importlib.metadata
import importlib.util
import platform
import shutil
import socket
from collections.abc import Iterator
from pathlib import Path

from common.host.site import Site
from spotter_tools.doctor.findings import Finding, broken, ok, warning

LOW_DISK_BYTES, NO_DISK_BYTES = 2_000_000_000, 200_000_000
_TIME_ERROR = 5  # adjtimex(2): the clock is not synchronised
_PROVIDERS = ("TensorrtExecutionProvider", "CUDAExecutionProvider", "CPUExecutionProvider")  # best first


def check_ports(site: Site, host: str) -> Iterator[Finding]:
    """The router's ports answer, or are free for it."""
    own = site.host(host)
    where = own.listen or own.address
    for name, address, port in (("local_port", "127.0.0.1", own.local_port), ("port", where, own.port)):
        check = f"{host} {name}"
        try:
            socket.create_connection((address, port), timeout=1.0).close()
            yield ok(check, f"somebody listens on {address}:{port}")
        except OSError as error:
            yield broken(
                check,
                f"nobody listens on {address}:{port} ({error.strerror or error})",
                f"start the router: spotter up {host} (or systemctl start spotter-router); is the address this host's?",
            )


def check_machine(folder: Path, low_bytes: int = LOW_DISK_BYTES, none_bytes: int = NO_DISK_BYTES) -> Iterator[Finding]:
    """Disk, clock, versions."""
    free_bytes = shutil.disk_usage(folder).free
    free, do = f"{free_bytes / 1e9:.1f} GB free in {folder.absolute()}", "delete old recordings or attach a disk"
    if free_bytes < low_bytes:
        yield (broken if free_bytes < none_bytes else warning)("disk", free, do)
    else:
        yield ok("disk", free)
    if _clock_synchronised():
        yield ok("clock", "the kernel says it is synchronised")
    else:
        yield warning("clock", "the kernel says it is not synchronised", "set up chrony or systemd-timesyncd")
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in ("spotter", "eclipse-zenoh"))
    yield ok("versions", f"{versions}, Python {platform.python_version()} on {platform.machine()}")


def check_provider(machine: str = "") -> Iterator[Finding]:
    """What the camera's network would run on here; ``machine`` as ``uname -m`` says it."""
    machine = machine or platform.machine()
    if importlib.util.find_spec("onnxruntime") is None:
        return
    try:
        onnxruntime = importlib.import_module("onnxruntime")  # an extra of some hosts only
    except (ImportError, OSError) as error:
        do = "install the build for this machine, with the versions of CUDA and cuDNN that it names"
        yield broken("onnxruntime", f"cannot be loaded: {error}", do)
        return
    available = onnxruntime.get_available_providers()
    in_use = next((name for name in _PROVIDERS if name in available), "none that we use")
    if ("arm" in machine or "aarch64" in machine) and in_use == _PROVIDERS[-1]:
        yield warning("onnxruntime", "runs on the CPU only", "on a Jetson install NVIDIA's onnxruntime build")
        return
    yield ok("onnxruntime", f"{onnxruntime.__version__}, networks run by {in_use}")


def _clock_synchronised() -> bool:
    """adjtimex(2) with ``modes`` 0 reads the state of the kernel's clock."""
    buffer = ctypes.create_string_buffer(1024)
    return int(ctypes.CDLL(None).adjtimex(buffer)) != _TIME_ERROR
