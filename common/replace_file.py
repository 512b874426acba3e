"""Atomic file replacement: readers see the old or the new file, never a part, also after a power cut."""

from __future__ import annotations

import os
import shutil
from pathlib import Path


def replace_text(path: Path, text: str) -> None:
    """Write a temporary file and rename it over the old one; a link stays a link, and the file's mode is kept.

    Raises:
        OSError: it cannot be written; a file of that name stays as it was.
    """
    target = path.resolve()
    part = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        with part.open("w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        if target.exists():
            shutil.copymode(target, part)
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)
