"""One way to end a command that cannot do its work: one line on stderr, exit code 1 (2 = wrong configuration)."""

from __future__ import annotations

import importlib.metadata
import sys
from pathlib import Path
from typing import NoReturn

CONSTRAINTS = Path(__file__).parents[2] / "constraints.txt"  # beside the packages in a clone, never in a wheel


def needs_extra(what: str, *extras: str) -> NoReturn:
    """End a command for which something is not installed, with how to get it: in a clone or from the wheel."""
    in_a_clone = f'uv pip install -c constraints.txt ".[{",".join(extras)}]"'
    wheel = f"spotter-{importlib.metadata.version('spotter')}-py3-none-any.whl"
    install = in_a_clone if CONSTRAINTS.exists() else f"pip install '{wheel}[{','.join(extras)}]'"
    named = f"the extra{'s' if len(extras) > 1 else ''} {' and '.join(f'`{one}`' for one in extras)}"
    fail(f"{what} {named}, which is not installed: {install}")


def fail(message: str, code: int = 1) -> NoReturn:
    """Print ``spotter: message`` and exit."""
    sys.stderr.write(f"spotter: {message}\n")
    raise SystemExit(code)
