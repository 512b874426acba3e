"""Where the `spotter` command begins: Ctrl-C while its modules are still being imported is as quiet as later on."""

from __future__ import annotations

import os
from typing import NoReturn

INTERRUPTED = 130


def main() -> NoReturn:
    """Entry point of the console script."""
    try:
        from spotter_tools.cli.__main__ import main as run
    except KeyboardInterrupt:
        os._exit(INTERRUPTED)  # nothing was begun that has to be cleared up
    run()


if __name__ == "__main__":
    main()
