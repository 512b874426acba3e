"""The register of issued names, ``keys/names.json``: public, copied to every host beside its certificate.

A certificate's common name is what the access rules allow. A name that was revoked may be issued again; it then gets a
new common name (``pi0.2``), because the old certificate is still valid until it expires.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import msgspec

from common.config import ConfigError

FILE = "names.json"
Kind = Literal["host", "laptop"]


class Name(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One name: its kind, how often it was issued and which common names are no longer allowed."""

    kind: Kind
    generation: int = 1
    serial: str = ""
    expires: str = ""  # ISO date, for people
    revoked: tuple[str, ...] = ()  # common names

    def common_name(self, name: str) -> str:
        """The common name in the certificate: the name, and the generation after a new issue."""
        return name if self.generation == 1 else f"{name}.{self.generation}"

    def allowed(self, name: str) -> bool:
        """Whether the newest certificate of the name is not revoked."""
        return self.common_name(name) not in self.revoked


class Names(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All names that the site's authority has issued, as ``names.json`` keeps them."""

    names: dict[str, Name] = {}

    def allowed(self, kind: Kind) -> dict[str, str]:
        """Name -> common name, of all of this kind that are not revoked."""
        return {n: e.common_name(n) for n, e in self.names.items() if e.kind == kind and e.allowed(n)}

    def with_name(self, name: str, entry: Name) -> Names:
        """These names and one more, or another entry for one."""
        return Names(names={**self.names, name: entry})


def read_names(folder: Path) -> Names:
    """The register; empty when there is none yet.

    Raises:
        ConfigError: unreadable or not ours.
    """
    path = folder / FILE
    try:
        return msgspec.json.decode(path.read_bytes(), type=Names)
    except FileNotFoundError:
        return Names()
    except (OSError, msgspec.DecodeError) as error:
        raise ConfigError(f"{path}: {error}") from None


class NamesWatch:
    """Whether the register has been replaced; rules made from the old one have to be made again."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._first = self._last = self._mark()
        self._known = read_names(folder)

    def changed(self) -> bool:
        """True, from then on, once another one has stood still since the last call.

        Raises:
            ConfigError: it cannot be read.
        """
        mark = self._mark()
        settled, self._last = mark == self._last, mark
        if not settled or mark in (None, self._first):  # None: being replaced, or gone; no reason to shut all out
            return False
        return read_names(self._folder) != self._known

    def _mark(self) -> tuple[int, ...] | None:
        try:
            found = (self._folder / FILE).stat()
        except OSError:
            return None
        return found.st_ino, found.st_mtime_ns, found.st_size


def write_names(folder: Path, names: Names) -> None:
    """Replace the register at once, so that a reader never sees half of it."""
    draft = folder / f".{FILE}"
    draft.write_bytes(msgspec.json.format(msgspec.json.encode(names), indent=2) + b"\n")
    draft.replace(folder / FILE)
