"""The three IMUs at register level, as their data sheets have them: identity, sleep, banks, modes, byte order."""

from __future__ import annotations

import math
from collections.abc import Callable

Rate = Callable[[], tuple[float, float, float]]  # degrees per second about x, y, z


class EmulatedImu:
    """A chip that turns as ``rate`` says. Unplugged (``present`` False) it does not acknowledge.

    Args:
        name: "mpu6050", "icm20948" or "bno055".
        rate: asked at every read of the gyroscope.
    """

    def __init__(self, name: str, rate: Rate) -> None:
        self.present = True
        self.closed = 0  # so often the bus was let go
        self._name, self._rate = name, rate
        self._bank = 0
        self._registers: dict[tuple[int, int], int] = {}
        self.lose_power()

    def lose_power(self) -> None:
        """For a moment: everything as it is after switching on."""
        at_reset = {
            "mpu6050": {(0, 0x75): 0x68, (0, 0x6B): 0x40},  # asleep
            "icm20948": {(0, 0x00): 0xEA, (0, 0x06): 0x41, (2, 0x01): 0x01},  # asleep
            "bno055": {(0, 0x00): 0xA0, (0, 0x3D): 0x00, (0, 0x3B): 0x80},  # configuration mode
        }
        self._registers, self._bank = dict(at_reset[self._name]), 0

    def write(self, register: int, value: int) -> None:
        """One byte; a register that only the configuration mode may set keeps its value outside of it."""
        self._acknowledge()
        if self._name == "icm20948" and register == 0x7F:
            self._bank = value >> 4 & 3
            return
        if register == {"mpu6050": 0x6B, "icm20948": 0x06}.get(self._name) and self._bank == 0 and value & 0x80:
            self.lose_power()
            return
        if self._name == "bno055" and register == 0x3B and self._mode != 0:
            return
        self._registers[(self._bank, register)] = value

    def read(self, register: int, count: int) -> bytes:
        """Some bytes from ``register`` on; the gyroscope's six as they are at this moment."""
        self._acknowledge()
        if self._bank == 0 and register == {"mpu6050": 0x43, "icm20948": 0x33, "bno055": 0x14}[self._name]:
            return self._gyroscope()[:count]
        return bytes(self._registers.get((self._bank, register + i), 0) for i in range(count))

    def close(self) -> None:
        """The bus is let go; the chip stays as it was set up."""
        self.closed += 1

    @property
    def _mode(self) -> int:
        return self._registers.get((0, 0x3D), 0)

    def _acknowledge(self) -> None:
        if not self.present:
            raise OSError(121, "Remote I/O error")

    def _gyroscope(self) -> bytes:
        order = "little" if self._name == "bno055" else "big"
        raw = (_saturated(rate * self._lsb_per_dps(), self._name) for rate in self._rate())
        return b"".join(value.to_bytes(2, "little" if order == "little" else "big", signed=True) for value in raw)

    def _lsb_per_dps(self) -> float:
        """0 while the gyroscope is off."""
        if self._name == "mpu6050":
            scale = self._registers.get((0, 0x1B), 0) >> 3 & 3
            return 0.0 if self._registers[(0, 0x6B)] & 0x40 else 131.0 / 2**scale
        if self._name == "icm20948":
            scale = self._registers.get((2, 0x01), 1) >> 1 & 3
            return 0.0 if self._registers[(0, 0x06)] & 0x40 else 131.0 / 2**scale
        per_unit = 900.0 * math.pi / 180 if self._registers[(0, 0x3B)] & 0x02 else 16.0
        return per_unit if self._mode in (0x03, 0x05, 0x06, 0x07, 0x08, 0x0B, 0x0C) else 0.0


def _saturated(value: float, name: str) -> int:
    limit = 32000 if name == "bno055" else 32767
    return max(-limit - 1, min(limit, round(value)))
