"""How kernels are compiled, and where the compiled code is kept.

Kernels are plain typed loops. ``error_model="numpy"`` matters: with the default model every division is checked, and
loops are no longer vectorised. ``fastmath`` is left out: it moves points across cell edges.

Compiled code is kept in ``BASE/kernels/HASH``. BASE is NUMBA_CACHE_DIR, or ``__pycache__`` beside this file. HASH is
that of all sources of this package: a compiled kernel contains the functions it calls and the constants it names, also
those of other files, but Numba compares the kernel's own file only. An image brings compiled kernels with it, in the
folder SPOTTER_KERNELS; they are copied on the first start, because Numba writes where it reads.
"""

from __future__ import annotations

import hashlib
import logging
import os
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])

log = logging.getLogger(__name__)

PACKAGE = Path(__file__).parent
HASH_DIGITS = 16
COMPLETE = "complete"  # an empty file in the folder, made when all kernels are there
PROBE_BYTES = 2_000_000


def cache_folder(base: Path) -> Path:
    """``base/kernels/HASH`` for the sources as they are now.

    ``base`` may be such a folder itself: a child process inherits the NUMBA_CACHE_DIR that its parent has set.
    """
    if base.parent.name == "kernels" and len(base.name) == HASH_DIGITS:
        base = base.parent.parent
    digest = hashlib.sha256()
    for file in sorted(PACKAGE.rglob("*.py")):
        digest.update(str(file.relative_to(PACKAGE)).encode() + b"\0" + file.read_bytes())
    return base / "kernels" / digest.hexdigest()[:HASH_DIGITS]


def copy_shipped(shipped: Path, folder: Path) -> None:
    """Copy the kernels that an image brings in ``shipped`` to ``folder``, unless that exists.

    Another process may do the same at the same time: each copies to a folder of its own, the first rename counts.
    Where copying fails, the log says why, and the kernels are compiled.
    """
    compiled = shipped / "kernels" / folder.name
    if folder.exists() or not compiled.is_dir():
        return
    part = folder.with_name(f"{folder.name}.{os.getpid()}")
    try:
        shutil.copytree(compiled, part)
        part.rename(folder)
    except OSError as error:
        shutil.rmtree(part, ignore_errors=True)
        if not folder.exists():
            log.warning("cannot copy the compiled kernels of %s: %s", shipped, error)


def use_cache_folder() -> Path:
    """Make Numba keep compiled code in the folder for the present sources; returns it."""
    folder = cache_folder(Path(os.environ.get("NUMBA_CACHE_DIR") or PACKAGE / "__pycache__"))
    if os.environ.get("SPOTTER_KERNELS"):
        copy_shipped(Path(os.environ["SPOTTER_KERNELS"]), folder)
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    numba.config.reload_config()
    return folder


def takes_files(folder: Path) -> bool:
    """Whether Numba may use the folder: it refuses one that is read-only, and ends the process on a full disk.

    The log says why not; kernels are then compiled at each start.
    """
    probe = folder / f"probe.{os.getpid()}"
    size = 0 if (folder / COMPLETE).exists() else PROBE_BYTES
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(bytes(size))
    except OSError as error:
        log.warning("%s: %s; kernels cannot be kept, each start compiles them", folder, error.strerror or error)
        return False
    finally:
        with suppress(OSError):
            probe.unlink(missing_ok=True)
    return True


CACHE = use_cache_folder()
KEPT = takes_files(CACHE)


def kernel(function: F) -> F:
    """Compile on the first call for the argument types met, single-threaded, without the interpreter lock."""
    return cast(F, numba.njit(nogil=True, cache=KEPT, error_model="numpy")(function))
