"""What the radar's tests share: emulated chips on a clock that is run by hand, and exports of Infineon's tools."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass

import msgspec
import numpy as np
import pytest

from common.bus.status import Report
from services.radar_pi.chip import registers as reg
from services.radar_pi.chip.driver import Driver, RadarFrame
from services.radar_pi.chip.exports import plan
from services.radar_pi.chip.registers import Gsr0, Register
from services.radar_pi.chip.schedule import WordSchedule
from services.radar_pi.config import WaveformConfig
from services.radar_pi.emulator import signals
from services.radar_pi.emulator.emulator import EmulatedChip
from services.radar_pi.emulator.manual_clock import ManualClock

DEFAULT = plan(WaveformConfig())
SPEED_HZ = 50_000_000
SMALL = WaveformConfig(samples=32, chirps=8, sample_rate_hz=2e6, chirp_period_s=0.2e-3, frame_period_s=5e-3)


class Probed(EmulatedChip):
    """The emulated chip, and the words on its wire spelt out."""

    def read(self, register: int) -> int:
        return int.from_bytes(self.transfer(reg.read_command(register))[1:], "big")

    def write(self, register: int, value: int) -> bytes:
        return self.transfer(reg.write_command(register, value))

    def status(self) -> Gsr0:
        return Gsr0(self.transfer(reg.read_command(Register.MAIN))[0] & 0x0F)

    def burst(self, words: int) -> bytes:
        return self.transfer(reg.burst_command() + bytes(3 * words))

    def fill(self) -> int:
        return reg.FILL_STATUS.value(self.read(Register.FSTAT))

    def start(self, waveform: WaveformConfig = SMALL, mark: int = 8191, **fields: int) -> WordSchedule:
        """Program a waveform and start it, headers on; ``fields`` are further SFCTL bits."""
        what = plan(waveform)
        header = fields.pop("header", 1)
        for address, value in what.registers.items():
            self.write(address, value)
        sfctl = reg.FIFO_CREF.bits(mark) | reg.PREFIX_EN.bits(header) | reg.LFSR_EN.bits(fields.pop("lfsr", 0))
        self.write(Register.SFCTL, sfctl)
        self.write(Register.MAIN, what.registers[Register.MAIN] | 1)
        return WordSchedule(what.timing, len(what.waveform.rx), 3 * header)


Spoil = Callable[[bytes, bytes], bytes]  # (what was sent, the true reply) -> the reply that arrives


class Wire:
    """The emulated chip with everything that crosses the link written down, and perhaps spoilt."""

    def __init__(self, chip: EmulatedChip, spoil: Spoil = lambda sent, reply: reply) -> None:
        self.chip, self._spoil = chip, spoil
        self.max_bytes = chip.max_bytes
        self.log: list[str] = []
        self.threads: set[int] = set()

    def transfer(self, data: bytes) -> bytes:
        self.threads.add(threading.get_ident())
        self.log.append(data[:4].hex())
        return self._spoil(data, self.chip.transfer(data))

    def set_reset(self, *, active: bool) -> None:
        self.log.append("reset" if active else "run")
        self.chip.set_reset(active=active)

    def wait_irq(self, timeout_s: float) -> bool:
        return self.chip.wait_irq(timeout_s)

    def close(self) -> None:
        self.log.append("close")


class Numbered:
    """A signal whose frames can be told apart; every frame that was measured is kept."""

    def __init__(self) -> None:
        self.measured: dict[int, tuple[float, np.ndarray]] = {}
        self._rng = np.random.default_rng(5)

    def __call__(self, t_s: float, waveform: WaveformConfig) -> np.ndarray:
        shape = (len(waveform.rx), waveform.chirps, waveform.samples)
        number = len(self.measured) + 1
        frame = self._rng.integers(1, 4096, shape, np.uint16)
        frame[0, 0, 0] = number
        self.measured[number] = (t_s, frame)
        return frame


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
def chip(clock: ManualClock) -> EmulatedChip:
    """A healthy chip on a 50 MHz bus that receives noise."""
    return EmulatedChip(clock, signals.noise(seed=1), speed_hz=SPEED_HZ)


@pytest.fixture
def probed_chip(clock: ManualClock) -> Probed:
    return Probed(clock, signals.noise(seed=3))


@pytest.fixture
def wire_class() -> type[Wire]:
    return Wire


@pytest.fixture
def signal() -> Numbered:
    return Numbered()


@pytest.fixture
def numbered_chip(clock: ManualClock, signal: Numbered) -> EmulatedChip:
    return EmulatedChip(clock, signal, speed_hz=SPEED_HZ)


@pytest.fixture
def frames(chip: EmulatedChip, clock: ManualClock, report: Report) -> Iterator[Iterator[RadarFrame]]:
    """What the driver makes of the file's chip."""
    with closing(Driver(chip, clock, DEFAULT, SPEED_HZ, report).frames()) as running:
        yield running


# The parts of a register list that its settings decide; the other registers are the same in every export.
_COMMON = {
    "MAIN": 0x1E8270, "PACR1": 0xE967FD, "PACR2": 0x0805B4, "SFCTL": 0x1027FF, "CSP_I_0": 0, "CSP_I_1": 0, "CSP_I_2": 0,
    "CSCI": 0xBE0, "CSP_D_0": 0, "CSP_D_1": 0, "CSP_D_2": 0, "CSCDS": 0xB60, "CS1": 0x490, "CS2": 0x480, "CS3": 0x480,
    "CS4": 0x480, "CCR0": 0x11BE0E, "CCR3": 0x787E1E, "PLL1_4": 0, "PLL1_5": 0, "PLL1_6": 0, "PLL2_7": 0x100,
    "PLL3_7": 0x100, "PLL4_7": 0x100, "RFT1": 0, "SDFT0": 0,
}  # fmt: skip


@dataclass(frozen=True)
class Export:
    """A published pair of register list and settings."""

    registers: dict[str, int]
    settings: WaveformConfig
    printed_chirp: str  # as the settings print it
    printed_frame: str

    @property
    def by_address(self) -> dict[int, int]:
        return {int(Register[name]): value for name, value in (_COMMON | self.registers).items()}

    def changed(self, registers: dict[str, int]) -> Export:
        """With other values of these registers; nothing is known of what was printed for them."""
        return Export(self.registers | registers, self.settings, "", "")


def _settings(start_ghz: float, end_ghz: float, samples: int, chirps: int, **more: float) -> WaveformConfig:
    values = {
        "sample_rate_hz": 2e6,
        "rx_mask": 7,
        "if_gain_db": 23,
        "hp_cutoff_hz": 80_000,
        "tx_power_level": 31,
    } | more
    bands = {"start_frequency_hz": start_ghz * 1e9, "end_frequency_hz": end_ghz * 1e9}
    return msgspec.convert(bands | {"samples": samples, "chirps": chirps} | values, WaveformConfig)


_5M = {
    "ADC0": 0x0A0210, "SADC_CTRL": 0x010700, "CS1_U_0": 0x13FC51, "CS1_U_1": 0x7FF41F, "CS1_U_2": 0x701CE7,
    "CCR1": 0x5D7C0A, "CCR2": 0x03F000, "PLL1_0": 0xA89A94, "PLL1_1": 0x262, "PLL1_2": 0x2B2, "PLL1_3": 0x80,
    "PLL1_7": 0x344B10,
}  # fmt: skip
_5M_TIMES = {"chirp_period_s": 0.0010007125092670321, "frame_period_s": 0.10000739991664886}
EXPORTS = {
    # Radar Fusion GUI, config_3rx_5m: single precision prints of 1.0007125 ms and 100.0074 ms
    "3rx_5m": Export(_5M, _settings(58, 60, 128, 64, **_5M_TIMES), "0.0010007125092670321", "0.10000739991664886"),
    # C header of the recorder's usual setting with 32 chirps: 591.125 us, 77.169 ms
    "58_to_63.5_ghz": Export(
        _5M
        | {
            "SADC_CTRL": 0x010D00, "CCR1": 0x646C0A, "CCR2": 0x01F000, "PLL1_0": 0xA2A850, "PLL1_1": 0xC88,
            "PLL1_2": 0x172, "PLL1_3": 0x40, "PLL1_7": 0x393B10,
        },
        _settings(58, 63.5, 64, 32, chirp_period_s=0.000591125, frame_period_s=0.077169),
        "0.0005911249900236726",
        "0.07716900",
    ),
    # config_track: two receivers, deep sleep between chirps
    "track": Export(
        _5M
        | {
            "ADC0": 0x140210, "SADC_CTRL": 0x010F00, "CS1_U_0": 0x133C51, "CS1_U_1": 0x5FF41F, "CS1_U_2": 0x70318C,
            "CCR1": 0x6E740A, "CCR2": 0x00F000, "PLL1_0": 0xA98B66, "PLL1_1": 0xC7, "PLL1_2": 0x1432, "PLL1_3": 0x200,
            "PLL1_7": 0x321D10,
        },
        _settings(
            58, 63, 512, 16, sample_rate_hz=1e6, rx_mask=5, if_gain_db=33, hp_cutoff_hz=20_000,
            chirp_period_s=0.00199924991466105, frame_period_s=0.2003144919872284,
        ),
        "0.00199924991466105",
        "0.2003144919872284",
    ),
    "3rx_2m": Export(
        _5M | {"PLL1_0": 0xA681DC, "PLL1_1": 0x5F6},
        _settings(58, 63, 128, 64, **_5M_TIMES), "0.0010007125092670321", "0.10000739991664886",
    ),
    "3rx_10m": Export(
        _5M | {"PLL1_0": 0xA94D4A, "PLL1_1": 0x131},
        _settings(58, 59, 128, 64, **_5M_TIMES), "0.0010007125092670321", "0.10000739991664886",
    ),
}  # fmt: skip


@pytest.fixture(params=EXPORTS)
def export(request: pytest.FixtureRequest) -> Export:
    return EXPORTS[request.param]


@pytest.fixture
def exports() -> dict[str, Export]:
    return EXPORTS
