"""What the subcommands that make a forest share: what they say, what they need, how they write it."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

from common.config import ConfigError
from services.infra_lidar.classification.forest import Forest


def say(*lines: str) -> None:
    """Lines on standard output, at once."""
    sys.stdout.write("\n".join(lines) + "\n")
    sys.stdout.flush()


def require_train() -> None:
    """Before any work is done.

    Raises:
        ConfigError: the extra ``train`` is not installed.
    """
    if importlib.util.find_spec("sklearn") is None:
        raise ConfigError(
            "train, evaluate and adapt need the extra `train`, which is not installed: "
            'uv pip install -c constraints.txt ".[train]"'
        )


def write_forest(forest: Forest, path: Path) -> str:
    """Write it; returns the file's size for people, such as ``812 kB``.

    Raises:
        ConfigError: it cannot be written.
    """
    try:
        forest.save(path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from None
    return f"{path.stat().st_size / 1e3:.0f} kB"
