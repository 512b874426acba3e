"""The DreamHAT+ on a Raspberry Pi 5: spidev and gpiod behind the ``Link`` seam (extra ``radar-hw``)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from common.clock import monotonic_s
from services.radar_pi.chip.gpio import AUTO, HEADER_LABELS, header_chip, labels
from services.radar_pi.config import SpiConfig

_BUFFER_LIMIT = Path("/sys/module/spidev/parameters/bufsiz")
_LARGEST_TRANSFER = 4096  # of spidev's xfer2, and the kernel's default


class HardwareError(OSError):
    """A device or a library is missing; the text says what to do."""


class SpiLink:
    """SPI bus, reset line (active low) and interrupt line (rising edge)."""

    def __init__(self, config: SpiConfig) -> None:
        """Open bus and lines.

        Raises:
            HardwareError: library, device or permission missing.
        """
        self.max_bytes = _buffer_limit()
        self._reset, self._irq = config.reset_gpio, config.irq_gpio
        self._spi = _open_bus(config)
        try:
            self._gpiod, self._lines = _request_lines(config)
        except HardwareError:
            self._spi.close()
            raise

    def transfer(self, data: bytes) -> bytes:
        return bytes(self._spi.xfer2(list(data)))

    def set_reset(self, *, active: bool) -> None:
        value = self._gpiod.line.Value
        self._lines.set_value(self._reset, value.INACTIVE if active else value.ACTIVE)

    def wait_irq(self, timeout_s: float) -> bool:
        """A level that is already there counts; edges from before are thrown away."""
        end_s = monotonic_s() + timeout_s
        while not self._is_high():
            left_s = end_s - monotonic_s()
            if left_s <= 0 or not self._lines.wait_edge_events(left_s):
                return self._is_high()
            self._lines.read_edge_events()  # perhaps of an earlier burst
        return True

    def close(self) -> None:
        self._lines.release()
        self._spi.close()

    def _is_high(self) -> bool:
        return bool(self._lines.get_value(self._irq) == self._gpiod.line.Value.ACTIVE)


def _open_bus(config: SpiConfig) -> Any:
    try:
        import spidev
    except ImportError:
        raise HardwareError("library spidev is missing: install the extra radar-hw") from None
    bus = spidev.SpiDev()
    try:
        bus.open(config.bus, config.device)
    except FileNotFoundError:
        raise HardwareError(f"/dev/spidev{config.bus}.{config.device} is missing: dtparam=spi=on") from None
    except PermissionError:
        raise HardwareError(f"/dev/spidev{config.bus}.{config.device}: this user is not in group spi") from None
    bus.mode = 0
    bus.max_speed_hz = config.speed_hz
    return bus


def _request_lines(config: SpiConfig) -> tuple[Any, Any]:
    try:
        import gpiod
        import gpiod.line
    except ImportError:
        raise HardwareError("library gpiod is missing: install the extra radar-hw") from None
    line = gpiod.line
    settings = {
        config.reset_gpio: gpiod.LineSettings(direction=line.Direction.OUTPUT, output_value=line.Value.ACTIVE),
        config.irq_gpio: gpiod.LineSettings(direction=line.Direction.INPUT, edge_detection=line.Edge.RISING),
    }
    chip = _chip(gpiod, config)
    try:
        return gpiod, gpiod.request_lines(chip, consumer="spotter-radar", config=settings)
    except FileNotFoundError:
        raise HardwareError(f"{chip} is missing: see [spi] gpio_chip") from None
    except PermissionError:
        raise HardwareError(f"{chip}: this user is not in group gpio") from None
    except OSError as error:
        lines = f"GPIO {config.reset_gpio}, {config.irq_gpio} of {chip}"
        raise HardwareError(f"{lines}: {error.strerror}; does another program hold them?") from None


def _chip(gpiod: Any, config: SpiConfig) -> str:
    if config.gpio_chip != AUTO:
        return config.gpio_chip
    try:
        found = labels(gpiod)
    except PermissionError as error:
        raise HardwareError(f"{error.filename or 'GPIO'}: this user is not in group gpio") from None
    chip = header_chip(found)
    if chip is None:
        there = ", ".join(f"{path} ({label})" for path, label in found.items()) or "none"
        raise HardwareError(
            f"no GPIO chip is the header's: expected one of {', '.join(HEADER_LABELS)}, found {there}; "
            'name it: [spi] gpio_chip = "/dev/gpiochipN"'
        )
    return chip


def _buffer_limit() -> int:
    """Bytes that the kernel moves in one transfer, if somebody made that less than what spidev allows."""
    try:
        return min(int(_BUFFER_LIMIT.read_text()), _LARGEST_TRANSFER)
    except (OSError, ValueError):
        return _LARGEST_TRANSFER
