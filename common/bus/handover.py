"""How a service takes over from a running one: beside it under a shadow prefix first, then in its place.

The contract, for a service in any language (``spotter swap`` is the other side of it):

1. started with SPOTTER_SHADOW=shadow it speaks below that chunk: ``shadow/<host>/<service>/<product>``;
2. on SIGUSR1 it speaks under the live keys, its ``seq`` going on, and after its first live message declares the token
   ``<host>/<service>/alive/<its id>-after-<SPOTTER_SUCCEEDS>``: the id says that these two do not compete;
3. once that token is there and that message was heard, the old one is stopped.

A process that was warm in the shadow stays warm: nothing is opened, calibrated or compiled again.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable

PROMOTE = signal.SIGUSR1


class Handover:
    """What the environment says of this process' place; ``prefix`` is empty for a live one."""

    def __init__(self) -> None:
        shadow = os.environ.get("SPOTTER_SHADOW", "")
        self.prefix = f"{shadow}/" if shadow else ""
        self.succeeds = os.environ.get("SPOTTER_SUCCEEDS", "") if shadow else ""
        if shadow:  # the handler only writes a byte: it may interrupt the main thread anywhere, locks held
            self._promoted, tell = os.pipe()
            signal.signal(PROMOTE, lambda *_: os.write(tell, b"!") and None)

    def when_promoted(self, go_live: Callable[[], None]) -> None:
        """Call ``go_live`` from a thread of its own when the signal comes. Nothing to wait for in a live process."""
        if not self.prefix:
            return

        def wait() -> None:
            os.read(self._promoted, 1)
            self.prefix = ""
            go_live()

        threading.Thread(target=wait, name="handover", daemon=True).start()
