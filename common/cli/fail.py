"""One way to end a command that cannot do its work: one line on stderr, exit code 1 (2 = wrong configuration)."""

from __future__ import annotations

import sys
from typing import NoReturn


def fail(message: str, code: int = 1) -> NoReturn:
    """Print ``spotter: message`` and exit."""
    sys.stderr.write(f"spotter: {message}\n")
    raise SystemExit(code)
