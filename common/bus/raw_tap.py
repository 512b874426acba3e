"""Raw bytes of a sensor on the bus: what the device sent, before it is interpreted.

A service passes every piece to its tap, which publishes it only while there is a subscriber (``spotter record --raw``).
``common/recording/raw.py`` reads the pieces back, and the same service processes them again.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import msgspec
import numpy as np

from common.clock import monotonic_s
from common.config import ConfigError
from common.messages import RawBytes

PATIENCE_S = 1.0  # from the first piece on: within this time an earlier subscriber is discovered
C = TypeVar("C", bound=msgspec.Struct)
Data = bytes | np.ndarray | Callable[[], np.ndarray]


class Outlet(Protocol):
    """What a tap needs of a publisher."""

    @property
    def wanted(self) -> bool:
        """True while there is a subscriber."""

    def __call__(self, message: RawBytes) -> None:
        """Send one piece."""


class RawTap:
    """Call it with every piece, in order. Costs almost nothing without a subscriber.

    The pieces of the first second are held back until a subscriber is found, so that a running recorder misses none:
    only a recording that begins with piece 0 gives exactly the same results again.

    Args:
        publish: the publisher of the service's raw topic.
        about: what a reader needs besides the bytes, sent with each piece.
    """

    def __init__(self, publish: Outlet, **about: object) -> None:
        self._publish, self.about = publish, dict(about)
        self._index = 0
        self._early: list[RawBytes] = []
        self._patient_until_s: float | None = None

    def __call__(
        self, kind: str, stamp_ns: int, data: Data, received_ns: int = 0, epoch: int = 0, **about: object
    ) -> None:
        """One piece: ``data`` as it came (bytes, an array in the device's own shape, or how to make it if wanted)."""
        index, self._index = self._index, self._index + 1
        if self._patient_until_s is None:
            self._patient_until_s = monotonic_s() + PATIENCE_S
        wanted = self._publish.wanted
        if not wanted and monotonic_s() > self._patient_until_s:
            self._early.clear()
            return
        piece = RawBytes(
            stamp_ns=stamp_ns, received_ns=received_ns, kind=kind, index=index, epoch=epoch, data=_array(data),
            about={**self.about, **about},
        )  # fmt: skip
        self._early.append(piece)
        if wanted:
            for piece in self._early:
                self._publish(piece)
            self._early.clear()


def null_tap(kind: str, stamp_ns: int, data: Data, received_ns: int = 0, epoch: int = 0, **about: object) -> None:
    """A tap that discards every piece, for a source without a bus."""


def _array(data: Data) -> np.ndarray:
    if isinstance(data, bytes):
        return np.frombuffer(data, np.uint8)
    return data if isinstance(data, np.ndarray) else data()


def changes(config: msgspec.Struct, fitted: msgspec.Struct) -> dict[str, Any]:
    """The top-level keys in which ``fitted``, which has values from the source, differs from the configuration."""
    names = [name for name in config.__struct_fields__ if getattr(config, name) != getattr(fitted, name)]
    return {name: msgspec.to_builtins(getattr(fitted, name)) for name in names}


def with_changes(config: C, changed: dict[str, Any]) -> C:
    """Apply such changes to another configuration.

    Raises:
        ConfigError: they do not fit its type.
    """
    try:
        return msgspec.convert({**msgspec.to_builtins(config), **changed}, type(config))
    except (msgspec.ValidationError, TypeError) as error:
        raise ConfigError(f"what the recording says of its source does not fit: {error}") from None
