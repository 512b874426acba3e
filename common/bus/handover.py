"""How a service replaces a running one: first it publishes under a shadow prefix, then under the live keys.

The protocol, for a service in any language (``spotter swap`` is the other side):

1. started with SPOTTER_SHADOW=shadow, it publishes under that prefix: ``shadow/<host>/<service>/<product>``;
2. on SIGUSR1 it publishes under the live keys, continues its ``seq``, and after its first live message declares the
   token ``<host>/<service>/alive/<its id>-after-<SPOTTER_SUCCEEDS>``: by this id the two are no conflict;
3. once that token and that message have arrived, the old one is stopped.

The process keeps running through all steps: nothing is opened, calibrated or compiled again.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable

PROMOTE = signal.SIGUSR1


class Handover:
    """The role of this process, from its environment; ``prefix`` is empty for a live one."""

    def __init__(self) -> None:
        shadow = os.environ.get("SPOTTER_SHADOW", "")
        self.prefix = f"{shadow}/" if shadow else ""
        self.succeeds = os.environ.get("SPOTTER_SUCCEEDS", "") if shadow else ""
        if shadow:  # the handler only writes a byte, because it may interrupt the main thread while locks are held
            self._promoted, writer = os.pipe()
            signal.signal(PROMOTE, lambda *_: os.write(writer, b"!") and None)

    def when_promoted(self, go_live: Callable[[], None]) -> None:
        """Call ``go_live`` from a separate thread when the signal comes. Does nothing in a live process."""
        if not self.prefix:
            return

        def wait() -> None:
            os.read(self._promoted, 1)
            self.prefix = ""
            go_live()

        threading.Thread(target=wait, name="handover", daemon=True).start()
