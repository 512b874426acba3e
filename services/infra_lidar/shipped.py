"""Compiled kernels that come with an installation, so that not even the first start waits for the compiler.

    python -m services.infra_lidar.shipped FOLDER        # while an image is built

compiles them for every level that this processor has. On a start they are laid where Numba looks for its own, which it
may add to: once for each installation, since the sources have to be those that were compiled.
"""

from __future__ import annotations

import logging
import os
import shutil
import subprocess
import sys
import uuid
from pathlib import Path

from llvmlite import binding

from common.processor import levels_of

log = logging.getLogger(__name__)

STAMP = "installation"  # a file that says which one


def lay_out(shipped: Path, kept: Path) -> bool:
    """Copy the folder ``shipped`` over ``kept``, unless it is there already. Whether something was copied."""
    stamp = shipped / STAMP
    if not stamp.is_file() or _read(stamp) == _read(kept / STAMP):
        return False
    for file in sorted(path for path in shipped.rglob("*") if path.is_file() and path != stamp):
        _copy(file, kept / file.relative_to(shipped))
    _copy(stamp, kept / STAMP)  # last: what was broken off is done again
    return True


def lay_out_own() -> bool:
    """Those of this installation: SPOTTER_KERNELS says where they are, NUMBA_CACHE_DIR where they are looked for. Where
    that cannot be done, the log says why, and they are compiled."""
    shipped, kept = os.environ.get("SPOTTER_KERNELS"), os.environ.get("NUMBA_CACHE_DIR")
    try:
        done = bool(shipped and kept) and lay_out(Path(str(shipped)), Path(str(kept)))
    except OSError as error:
        log.warning("the kernels of this installation cannot be laid out: %s", error)
        return False
    if done:
        log.info("kernels of this installation laid out in %s", kept)
    return done


def _read(file: Path) -> bytes:
    return file.read_bytes() if file.is_file() else b""


def _copy(file: Path, to: Path) -> None:
    """All of it or nothing: another process may be reading there."""
    to.parent.mkdir(parents=True, exist_ok=True)
    part = to.with_name(f".{to.name}.{os.getpid()}")
    shutil.copyfile(file, part)
    part.replace(to)


def ship(folder: Path) -> list[str]:
    """Compile for every level of this processor into ``folder``; returns which these are."""
    levels = levels_of(binding.get_host_cpu_features())
    for level in levels:
        environment = os.environ | {
            "NUMBA_CACHE_DIR": str(folder), "NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": "", "SPOTTER_KERNELS": "",
        }  # fmt: skip
        subprocess.run([sys.executable, "-m", "services.infra_lidar.compile_kernels"], env=environment, check=True)
    if levels:
        (folder / STAMP).write_text(uuid.uuid4().hex)
    return levels


if __name__ == "__main__":
    compiled = ship(Path(sys.argv[1]))
    sys.stdout.write(f"kernels compiled for {' and '.join(compiled) or 'nobody: this processor has no level'}\n")
