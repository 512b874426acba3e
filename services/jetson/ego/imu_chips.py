"""The gyroscopes of three IMUs over I2C: how they are set up and read. The bus is behind the ``I2c`` seam.

Sources: MPU-6000/6050 register map rev. 4.2; ICM-20948 data sheet rev. 1.5; BNO055 data sheet rev. 1.8.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, Protocol

AXES = ("x", "y", "z")
RADPS_OF_500_DPS = math.radians(1.0) / 65.5  # per LSB at +-500 degrees per second, both InvenSense chips
RADPS_OF_BNO055 = math.radians(1.0) / 16.0  # per LSB with the unit set to degrees per second


class I2c(Protocol):
    """One device on the bus. ``read`` and ``write`` raise ``OSError`` when it does not acknowledge."""

    def read(self, register: int, count: int) -> bytes:
        """So many bytes from a register on."""

    def write(self, register: int, value: int) -> None:
        """One byte into a register."""

    def close(self) -> None:
        """Let go of the bus."""


class WrongChip(OSError):
    """Somebody else answers at this address."""


class Chip(NamedTuple):
    """A kind of IMU: usual address, where it says who it is, and how it is used."""

    name: str
    address: int
    who: int  # register
    identity: int  # its content
    sample_s: float  # a new value at least this often
    start: Callable[[I2c, Callable[[float], None]], None]
    read: Callable[[I2c], tuple[int, int, int]]  # raw x, y, z
    radps_per_lsb: float
    full_scale: int  # raw values at or beyond are saturated


def open_chip(chip: Chip, bus: I2c, sleep: Callable[[float], None]) -> None:
    """Check the identity and set the chip up.

    Raises:
        OSError: nobody answers. WrongChip: somebody else does.
    """
    if chip.name == "icm20948":
        bus.write(0x7F, 0x00)  # the identity is in bank 0
    found = bus.read(chip.who, 1)[0]
    if found != chip.identity:
        raise WrongChip(f"identity 0x{found:02x} where {chip.name} has 0x{chip.identity:02x}: another chip?")
    chip.start(bus, sleep)


def _start_mpu6050(bus: I2c, sleep: Callable[[float], None]) -> None:
    bus.write(0x6B, 0x80)  # PWR_MGMT_1: reset
    sleep(0.1)
    bus.write(0x6B, 0x01)  # awake, clock from the gyroscope
    bus.write(0x1A, 0x03)  # CONFIG: low pass 42 Hz
    bus.write(0x1B, 0x08)  # GYRO_CONFIG: 500 dps
    sleep(0.05)


def _start_icm20948(bus: I2c, sleep: Callable[[float], None]) -> None:
    bus.write(0x7F, 0x00)  # REG_BANK_SEL: bank 0
    bus.write(0x06, 0x80)  # PWR_MGMT_1: reset
    sleep(0.1)
    bus.write(0x06, 0x01)  # awake, best clock
    bus.write(0x7F, 0x20)  # bank 2
    bus.write(0x01, 0x1B)  # GYRO_CONFIG_1: low pass 51 Hz, 500 dps
    bus.write(0x7F, 0x00)
    sleep(0.05)


def _start_bno055(bus: I2c, sleep: Callable[[float], None]) -> None:
    bus.write(0x3D, 0x00)  # OPR_MODE: configuration
    sleep(0.025)
    bus.write(0x07, 0x00)  # PAGE_ID
    bus.write(0x3B, 0x00)  # UNIT_SEL: degrees per second
    bus.write(0x3D, 0x03)  # OPR_MODE: gyroscope only
    sleep(0.025)


def _read_big(register: int) -> Callable[[I2c], tuple[int, int, int]]:
    def read(bus: I2c) -> tuple[int, int, int]:
        data = bus.read(register, 6)
        x, y, z = (int.from_bytes(data[i : i + 2], "big", signed=True) for i in (0, 2, 4))
        return x, y, z

    return read


def _read_bno055(bus: I2c) -> tuple[int, int, int]:
    data = bus.read(0x14, 6)  # GYR_DATA_X_LSB
    x, y, z = (int.from_bytes(data[i : i + 2], "little", signed=True) for i in (0, 2, 4))
    return x, y, z


CHIPS: dict[str, Chip] = {
    chip.name: chip
    for chip in (
        Chip("mpu6050", 0x68, 0x75, 0x68, 0.01, _start_mpu6050, _read_big(0x43), RADPS_OF_500_DPS, 32767),
        Chip("icm20948", 0x69, 0x00, 0xEA, 0.01, _start_icm20948, _read_big(0x33), RADPS_OF_500_DPS, 32767),
        Chip("bno055", 0x28, 0x00, 0xA0, 0.01, _start_bno055, _read_bno055, RADPS_OF_BNO055, 32000),
    )
}


class SmbusDevice:
    """A device on a real bus through smbus2 (extra ``vehicle``)."""

    def __init__(self, bus: int, address: int) -> None:
        """Raises ``OSError``: no library, no bus, no permission."""
        try:
            import smbus2
        except ImportError:
            raise OSError("library smbus2 is missing: install the extra vehicle") from None
        try:
            self._bus = smbus2.SMBus(bus)
        except FileNotFoundError:
            raise OSError(f"/dev/i2c-{bus} is missing: dtparam=i2c_arm=on, or another bus number") from None
        except PermissionError:
            raise OSError(f"/dev/i2c-{bus}: this user is not in group i2c") from None
        self._address = address

    def read(self, register: int, count: int) -> bytes:
        return bytes(self._bus.read_i2c_block_data(self._address, register, count))

    def write(self, register: int, value: int) -> None:
        self._bus.write_byte_data(self._address, register, value)

    def close(self) -> None:
        self._bus.close()
