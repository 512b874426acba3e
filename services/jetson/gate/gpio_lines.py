"""Output lines of a GPIO chip: libgpiod (extra ``vehicle``), or an emulated chip that writes down every change."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, TextIO

from common.clock import monotonic_s

EMULATOR = "emulator:"  # emulator:PATH instead of /dev/gpiochipN


class LineError(OSError):
    """A chip, a line or the library is missing; the text says what to do."""


class Lines(Protocol):
    """Some output lines, all inactive at first."""

    def set(self, values: Mapping[int, bool]) -> None:
        """Make these lines active or inactive."""

    def close(self) -> None:
        """All inactive, then let go."""


def open_lines(chip: str, offsets: tuple[int, ...], *, active_low: bool) -> Lines:
    """The lines of a chip.

    Raises:
        LineError: library, chip, line or permission missing.
    """
    if chip.startswith(EMULATOR):
        return EmulatedLines(Path(chip.removeprefix(EMULATOR)), offsets)
    return GpioLines(chip, offsets, active_low=active_low)


class GpioLines:
    """Real lines through libgpiod 2."""

    def __init__(self, chip: str, offsets: tuple[int, ...], *, active_low: bool) -> None:
        try:
            import gpiod
            import gpiod.line
        except ImportError:
            raise LineError("library gpiod is missing: install the extra vehicle") from None
        line = gpiod.line
        settings = gpiod.LineSettings(
            direction=line.Direction.OUTPUT, output_value=line.Value.INACTIVE, active_low=active_low
        )
        self._value, self._offsets = line.Value, offsets
        names = f"GPIO {', '.join(map(str, offsets))} of {chip}"
        try:
            self._request: Any = gpiod.request_lines(chip, consumer="spotter-gate", config={offsets: settings})
        except FileNotFoundError:
            raise LineError(f"{chip} does not exist: `gpioinfo` lists the chips") from None
        except PermissionError:
            raise LineError(f"{chip}: this user is not in group gpio") from None
        except ValueError as error:
            raise LineError(f"{names}: {error}") from None
        except OSError as error:
            raise LineError(f"{names}: {error.strerror}; does another program hold them?") from None

    def set(self, values: Mapping[int, bool]) -> None:
        value = self._value
        self._request.set_values({at: value.ACTIVE if on else value.INACTIVE for at, on in values.items()})

    def close(self) -> None:
        self.set(dict.fromkeys(self._offsets, False))
        self._request.release()


class EmulatedLines:
    """A file with one line a change: monotonic seconds, GPIO number, 0 or 1."""

    def __init__(self, path: Path, offsets: tuple[int, ...]) -> None:
        self._file: TextIO = path.open("a", encoding="ascii", buffering=1)
        self._now: dict[int, bool] = {}
        self._offsets = offsets
        self.set(dict.fromkeys(offsets, False))

    def set(self, values: Mapping[int, bool]) -> None:
        for at, on in values.items():
            if self._now.get(at) != on:
                self._now[at] = on
                self._file.write(f"{monotonic_s():.6f} {at} {int(on)}\n")

    def close(self) -> None:
        self.set(dict.fromkeys(self._offsets, False))
        self._file.close()
