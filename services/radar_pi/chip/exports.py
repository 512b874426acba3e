"""Infineon's exports: a register list and the settings JSON it was made from; recomputed, refused on a mismatch.

Register export (Radar Fusion GUI): lines ``NAME 0xADDR 0xVALUE``. C header (configurator): words ``0x11e8270UL`` =
address << 25 | write flag << 24 | value. Settings: the GUI's nested sequence or the recorder's ``fmcw_single_shape``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from common.config import ConfigError
from services.radar_pi.chip import waveform as wave
from services.radar_pi.chip.registers import ADC_DIV, SHAPE_PD_MODE, PdMode, Register, Registers
from services.radar_pi.chip.waveform import Timing
from services.radar_pi.config import WaveformConfig

_LINE = re.compile(r"^\s*\w+\s+(0x[0-9a-fA-F]+)\s+(0x[0-9a-fA-F]+)\s*$")
_WORD = re.compile(r"\b0x([0-9a-fA-F]{6,8})(?:UL|u|U|L)?\b")
_R = Register
_NEEDED = (
    *(_R.MAIN, _R.ADC0, _R.PACR1, _R.PACR2, _R.SFCTL, _R.CS1_U_0, _R.CS1_U_1, _R.CS1_U_2, _R.CS1),
    *(_R.CCR0, _R.CCR1, _R.CCR2, _R.CCR3, _R.PLL1_0, _R.PLL1_1, _R.PLL1_2, _R.PLL1_3, _R.PLL1_7),
)
_HALF_CLOCK_S = 0.5 / wave.CLOCK_HZ
_PRINTED = 1e-6  # the exports print single precision floats or six digits


@dataclass(frozen=True)
class Plan:
    """What is written into the chip, what it then does, and when."""

    registers: Registers
    waveform: WaveformConfig  # as the chip does it: quantised rates and periods
    timing: Timing


def plan(waveform: WaveformConfig) -> Plan:
    """The register list of a configuration: computed, or loaded from exports and checked.

    Raises:
        ConfigError: impossible for the chip, unreadable file, or register list and settings that do not match.
    """
    settings = read_settings(Path(waveform.settings_file)) if waveform.settings_file else waveform
    if not waveform.register_file:
        return _plan(wave.register_list(settings), waveform)
    if not waveform.settings_file:
        raise ConfigError(
            "[waveform] register_file needs settings_file as well: the two are checked against each other"
        )
    registers = parse_registers(_read(Path(waveform.register_file)), waveform.register_file)
    differences = mismatches(registers, settings)
    if differences:
        pair = f"{waveform.register_file} does not match {waveform.settings_file}"
        raise ConfigError(f"{pair}: {'; '.join(differences)}")
    return _plan(registers, waveform)


def parse_registers(text: str, origin: str = "registers") -> Registers:
    """Register export or C header -> registers by address.

    Raises:
        ConfigError: neither format, a value of more than 24 bits, or registers that a waveform needs are missing.
    """
    rows = [match.groups() for match in map(_LINE.match, text.splitlines()) if match]
    if rows:
        registers = {int(address, 16): int(value, 16) for address, value in rows}
    else:
        words = [int(word, 16) for word in _WORD.findall(text)]
        registers = {word >> 25: word & 0xFFFFFF for word in words}
    wrong = [address for address, value in registers.items() if value >> 24 or address >= Register.FIFO]
    if wrong:
        raise ConfigError(f"{origin}: no register of this chip: {', '.join(f'0x{a:02x}' for a in wrong)}")
    missing = [r.name for r in _NEEDED if r not in registers]
    if missing:
        raise ConfigError(f"{origin}: registers missing: {', '.join(missing)}")
    if ADC_DIV.of(registers) == 0:
        raise ConfigError(f"{origin}: ADC0 divides the clock by 0, expected by 1 or more")
    if (mode := SHAPE_PD_MODE.of(registers)) > max(PdMode):
        raise ConfigError(f"{origin}: power mode {mode} in the pause after a chirp, expected 0 to {max(PdMode)}")
    return registers


def read_settings(path: Path) -> WaveformConfig:
    """Settings JSON -> waveform.

    Raises:
        ConfigError: unreadable, not a single-shape sequence, or a value outside the limits of ``[waveform]``.
    """
    try:
        document = json.loads(_read(path))
        flat = _flat(document)
        return msgspec.convert(flat, WaveformConfig)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"{path}: not a settings file of this chip: {error!r}") from None


def mismatches(registers: Mapping[int, int], settings: WaveformConfig) -> list[str]:
    """Every setting that the registers contradict, as ``key: settings say x, registers say y``."""
    actual, timing = wave.waveform_of(registers), wave.timing_of(registers)
    ramp = timing.samples * timing.adc_divider
    tolerance = {
        "start_frequency_hz": 2 * wave.CODE_HZ,
        "end_frequency_hz": (ramp / 2 + 512) * wave.CODE_HZ,  # half a slope step for the length of the ramp
        "sample_rate_hz": 1e-2 * settings.sample_rate_hz,  # the configurator rounds to 80 MHz / n
        "chirp_period_s": _HALF_CLOCK_S + _PRINTED * settings.chirp_period_s,
        "frame_period_s": _HALF_CLOCK_S + _PRINTED * settings.frame_period_s,
    }
    exact = ("samples", "chirps", "rx_mask", "tx_power_level", "if_gain_db", "hp_cutoff_hz")
    return [
        f"{key}: settings say {getattr(settings, key)}, registers say {getattr(actual, key)}"
        for key in (*tolerance, *exact)
        if abs(getattr(settings, key) - getattr(actual, key)) > tolerance.get(key, 0)
    ]


def _plan(registers: Registers, asked: WaveformConfig) -> Plan:
    """The waveform keeps its files, so that planning what was planned gives the same."""
    files = {"register_file": asked.register_file, "settings_file": asked.settings_file}
    done = msgspec.structs.replace(wave.waveform_of(registers), **files)
    return Plan(registers, done, wave.timing_of(registers))


def _flat(document: Mapping[str, Any]) -> dict[str, Any]:
    """Both JSON layouts -> the keys of ``[waveform]``."""
    if "device_config" in document:
        shape = document["device_config"]["fmcw_single_shape"]
        chirps, rx_mask = shape["num_chirps_per_frame"], sum(1 << (n - 1) for n in shape["rx_antennas"])
        chirp_s, frame_s = shape["chirp_repetition_time_s"], shape["frame_repetition_time_s"]
        samples, lp_hz = shape["num_samples_per_chirp"], shape.get("aaf_cutoff_Hz", 500_000)
    else:
        (frame,) = document["sequence"]
        (loop,) = frame["sequence"]
        (shape,) = loop["sequence"]
        chirps, rx_mask = loop["num_repetitions"], shape["rx_mask"]
        chirp_s, frame_s = loop["repetition_time_s"], frame["repetition_time_s"]
        samples, lp_hz = shape["num_samples"], shape.get("lp_cutoff_Hz", 500_000)
    low, high = ("start", "end") if "start_frequency_Hz" in shape else ("lower", "upper")
    return {
        "start_frequency_hz": shape[f"{low}_frequency_Hz"],
        "end_frequency_hz": shape[f"{high}_frequency_Hz"],
        "samples": samples,
        "chirps": chirps,
        "sample_rate_hz": shape["sample_rate_Hz"],
        "chirp_period_s": chirp_s,
        "frame_period_s": frame_s,
        "rx_mask": rx_mask,
        "tx_power_level": shape["tx_power_level"],
        "if_gain_db": shape["if_gain_dB"],
        "hp_cutoff_hz": shape.get("hp_cutoff_Hz", 80_000),
        "lp_cutoff_hz": lp_hz,
    }


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: not a text file") from None
