"""What a compiled kernel was made from: its own file, and all of this project that the file takes in.

Numba keeps kernels on disk, and compiles one again when the file that it is written in has changed. But a kernel also
holds the functions that it calls and the numbers that it names, out of other files: after an update of one of those the
old code would run on, and nobody would see it. Here the stamp of a kernel covers them all.
"""

from __future__ import annotations

import re
from functools import cache
from hashlib import sha256
from pathlib import Path

from numba.core.caching import InTreeCacheLocator, UserProvidedCacheLocator, UserWideCacheLocator

from common.processor import config

ROOT = Path(__file__).parents[1]
PACKAGES = ("common", "services")
# By its form, since to parse all sources would cost each start 0.2 s.
_IMPORT = re.compile(r"^(?:from|import) +([\w.]+)(?: import +(\((?:[^)#]|#.*)*\)|.*))?", re.MULTILINE)


class _OfAllSources:
    """Numba asks where a kernel is kept, and for the stamp of what it was made from."""

    _py_file: str

    def get_source_stamp(self) -> str:
        return stamp(Path(self._py_file))


class UserProvided(_OfAllSources, UserProvidedCacheLocator):
    """Kept in the folder that NUMBA_CACHE_DIR names."""


class InTree(_OfAllSources, InTreeCacheLocator):
    """Kept beside the sources."""


class UserWide(_OfAllSources, UserWideCacheLocator):
    """Kept with the user's other caches: the sources cannot be written to."""


def watch_all_sources() -> None:
    """Before the first kernel is decorated."""
    config.CACHE_LOCATOR_CLASSES = ",".join(f"{__name__}.{kind.__name__}" for kind in (UserProvided, InTree, UserWide))


@cache
def stamp(file: Path) -> str:
    """Changes with the text of the file, or of any of its ``sources``."""
    return sha256(b"".join(map(_digest, sorted(sources(file))))).hexdigest()


@cache
def _digest(file: Path) -> bytes:
    return sha256(file.read_bytes()).digest()


def sources(file: Path) -> set[Path]:
    """The file and, of this project, what it imports, what those import, and so on."""
    found, waiting = set[Path](), [file]
    while waiting:
        source = waiting.pop()
        if source not in found:
            found.add(source)
            waiting += imported(source)
    return found


@cache
def imported(file: Path) -> tuple[Path, ...]:
    """The files of this project that a file imports at its top: what a function imports, no kernel can hold."""
    names = [name for module, listed in _IMPORT.findall(file.read_text()) for name in _modules_in(module, listed)]
    return tuple(path for name in names if name.partition(".")[0] in PACKAGES for path in _files_of(name))


def _modules_in(module: str, listed: str) -> list[str]:
    """Whatever may be a module: of ``from a import b, c as d`` a, a.b and a.c."""
    each = re.sub(r"#.*", "", listed).strip("() ").split(",")
    return [module, *(f"{module}.{words.split()[0]}" for words in each if words.strip())]


def _files_of(name: str) -> list[Path]:
    place = ROOT.joinpath(*name.split("."))
    return [path for path in (place.with_suffix(".py"), place / "__init__.py") if path.is_file()]
