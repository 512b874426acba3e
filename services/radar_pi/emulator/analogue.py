"""The chip's analogue part in registers: receivers, gains, filters, transmitter power, temperature reading."""

from __future__ import annotations

from collections.abc import Mapping

from common.config import ConfigError
from services.radar_pi.chip import registers as reg
from services.radar_pi.chip.registers import Register, Registers
from services.radar_pi.config import WaveformConfig

HP_CUTOFFS_HZ = (20_000, 45_000, 70_000, 80_000)
LP_CUTOFF_HZ = 500_000  # anti-alias filter, four poles


def receivers(waveform: WaveformConfig) -> Registers:
    """Mixers, gains, filters and transmitter power.

    Raises:
        ConfigError: a gain or a corner that the chip does not have.
    """
    if waveform.lp_cutoff_hz != LP_CUTOFF_HZ:
        text = f"[waveform] lp_cutoff_hz = {waveform.lp_cutoff_hz}: the chip's filter is fixed at {LP_CUTOFF_HZ}"
        raise ConfigError(text)
    mask = waveform.rx_mask
    enable = reg.TX_EN.bits(1) | reg.VCO_EN.bits(1) | reg.FDIV_EN.bits(1) | reg.BBCHGLOB_EN.bits(1)
    enable |= reg.LO_DIST1_EN.bits(1) | reg.LO_DIST2_EN.bits(1 if mask & 0b101 else 0)
    enable |= sum(reg.RX_EN[n].bits(0b11) for n in range(3) if mask >> n & 1)
    high_pass, vga = _gain_stages(waveform.if_gain_db)
    if waveform.hp_cutoff_hz not in HP_CUTOFFS_HZ:
        raise ConfigError(f"[waveform] hp_cutoff_hz = {waveform.hp_cutoff_hz}: the chip has {HP_CUTOFFS_HZ}")
    cutoff = HP_CUTOFFS_HZ.index(waveform.hp_cutoff_hz)
    gain = reg.HP_GAIN.bits(high_pass * 0b111)  # idle receivers are set as well, as in the exports
    gain |= sum(reg.VGA_GAIN[n].bits(vga) | reg.HPF_SEL[n].bits(cutoff) for n in range(3))
    channels = reg.BBCH_SEL.bits(mask) | reg.BB_RSTCNT.bits(127) | reg.TEMP_MEAS_EN.bits(1) | reg.MADC_EN.bits(1)
    return {
        Register.CS1_U_0: enable,
        Register.CS1_U_1: channels | reg.TX_DAC.bits(waveform.tx_power_level),
        Register.CS1_U_2: gain,
    }


def _gain_stages(gain_db: int) -> tuple[int, int]:
    """(HP_GAIN bit, VGA code): first stage 18 or 30 dB, second 0 to 30 dB in steps of 5."""
    for bit, first_db in ((1, 18), (0, 30)):
        steps, rest = divmod(gain_db - first_db, 5)
        if rest == 0 and 0 <= steps <= 6:
            return bit, steps
    raise ConfigError(f"[waveform] if_gain_db = {gain_db}: the chip has 18, 23 .. 48 and 30, 35 .. 60")


def gain_and_cutoff(registers: Mapping[int, int]) -> tuple[int, int]:
    """(total gain in dB, high-pass corner in Hz) of the active receivers.

    Raises:
        ConfigError: they differ.
    """
    mask = reg.BBCH_SEL.of(registers)
    stages = {
        (reg.HP_GAIN.of(registers) >> n & 1, reg.VGA_GAIN[n].of(registers), reg.HPF_SEL[n].of(registers))
        for n in range(3)
        if mask >> n & 1
    }
    if len(stages) != 1:
        raise ConfigError(f"registers: CS1_U_2: one gain and filter for all active receivers expected, got {stages}")
    ((high_pass, vga, cutoff),) = stages
    return (18 if high_pass else 30) + 5 * vga, HP_CUTOFFS_HZ[cutoff]


def temperature_adc(sampling_clocks: int) -> int:
    """The most accurate temperature reading that fits into one chirp: 20 MHz conversion clocks per setting."""
    settings = ((1440, 3, 1), (928, 3, 0), (180, 2, 1), (116, 2, 0), (90, 1, 1), (58, 1, 0), (45, 0, 1))
    fitting = ((over, spread) for clocks, over, spread in settings if sampling_clocks >= 4 * clocks)
    oversampling, spread = next(fitting, (0, 0))
    fixed = reg.SADC_TC_TRIM.bits(4) | reg.SADC_SD_EN.bits(1)
    return fixed | reg.SADC_OVERS_CFG.bits(oversampling) | reg.SADC_SESP.bits(spread)
