"""The header's GPIO chip is found by its label, whatever number the kernel gave it."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from services.radar_pi.chip.gpio import header_chip, labels


@pytest.mark.parametrize(
    ("found", "path"),
    [
        ({"/dev/gpiochip0": "pinctrl-rp1", "/dev/gpiochip10": "gpio-brcmstb@107d508500"}, "/dev/gpiochip0"),  # 6.6.45
        ({"/dev/gpiochip0": "gpio-brcmstb@107d508500", "/dev/gpiochip4": "pinctrl-rp1"}, "/dev/gpiochip4"),  # before
        ({"/dev/gpiochip0": "pinctrl-bcm2711", "/dev/gpiochip1": "raspberrypi-exp-gpio"}, "/dev/gpiochip0"),  # Pi 4
        ({"/dev/gpiochip0": "tegra234-gpio", "/dev/gpiochip1": "tegra234-gpio-aon"}, None),
        ({"/dev/gpiochip0": "pinctrl-rp1", "/dev/gpiochip1": "pinctrl-rp1"}, None),
        ({}, None),
    ],
)
def test_the_headers_chip(found: dict[str, str], path: str | None) -> None:
    assert header_chip(found) == path


def test_labels_are_read_from_every_chip(tmp_path: Path) -> None:
    for name in ("gpiochip4", "gpiochip0", "gpiochip9", "null"):
        (tmp_path / name).touch()

    @contextmanager
    def chip(path: str) -> Any:
        yield SimpleNamespace(get_info=lambda: SimpleNamespace(label=f"label of {Path(path).name}"))

    gpiod = SimpleNamespace(is_gpiochip_device=lambda path: not path.endswith("9"), Chip=chip)
    assert labels(gpiod, tmp_path) == {
        str(tmp_path / "gpiochip0"): "label of gpiochip0",
        str(tmp_path / "gpiochip4"): "label of gpiochip4",
    }
