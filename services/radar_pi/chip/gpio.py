"""Which of the machine's GPIO chips has the pins of the 40-pin header: found by its label, not by its number.

The number changes with the kernel: on a Raspberry Pi 5 the header was ``gpiochip4`` and is ``gpiochip0`` since 6.6.45.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

AUTO = "auto"
HEADER_LABELS = ("pinctrl-rp1", "pinctrl-bcm2711", "pinctrl-bcm2835")  # Raspberry Pi 5, 4, 3 and older


def labels(gpiod: Any, folder: Path = Path("/dev")) -> dict[str, str]:
    """Path to label of every GPIO chip of this machine.

    Raises:
        PermissionError: a chip may not be opened by this user.
    """
    found = {}
    for path in sorted(folder.glob("gpiochip*")):
        if gpiod.is_gpiochip_device(str(path)):
            with gpiod.Chip(str(path)) as chip:
                found[str(path)] = str(chip.get_info().label)
    return found


def header_chip(found: dict[str, str]) -> str | None:
    """The path of the header's chip; None when there is none, or more than one of a kind."""
    for label in HEADER_LABELS:
        paths = [path for path, name in found.items() if name == label]
        if paths:
            return paths[0] if len(paths) == 1 else None
    return None
