"""The device files of a graphics processor: systemd takes paths and kernel group names, no patterns of paths."""

from __future__ import annotations

from pathlib import Path

PATTERNS = ("nvmap", "nvhost-*", "nvgpu/*/*", "nvsciipc", "nvidia*", "dri/renderD*")
# Of a Jetson Orin with JetPack 6, for units that are written elsewhere; systemd passes over a path that is not there.
JETSON = (
    "/dev/nvmap", "/dev/nvhost-ctrl", "/dev/nvhost-ctrl-gpu", "/dev/nvhost-gpu", "/dev/nvhost-as-gpu",
    "/dev/nvhost-prof-gpu", "/dev/nvhost-ctxsw-gpu", "/dev/nvhost-dbg-gpu", "/dev/nvhost-tsg-gpu", "/dev/nvhost-vic",
    "/dev/nvhost-nvdec", "/dev/nvhost-nvjpg", "/dev/nvsciipc", "/dev/dri/renderD128",
)  # fmt: skip


def gpu_devices(dev: Path = Path("/dev")) -> tuple[str, ...]:
    """Those of this machine; of a Jetson where it has none."""
    found = sorted({str(path) for pattern in PATTERNS for path in dev.glob(pattern) if not path.is_dir()})
    return tuple(found) or JETSON
