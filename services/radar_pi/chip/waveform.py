"""A readable waveform <-> the chip's register list and its exact timing.

Times are integers in clocks of the 80 MHz reference (12.5 ns), so periods come out exact to the last digit. Formulas:
data sheet V2.4.9, sections "Chirp timing" and "PLL registers"; the rounding is the one of Infineon's exports, which the
tests reproduce bit for bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from common.config import ConfigError
from services.radar_pi.chip import registers as reg
from services.radar_pi.chip.registers import Field, PdMode, Register, Registers
from services.radar_pi.config import WaveformConfig
from services.radar_pi.emulator.analogue import gain_and_cutoff, receivers, temperature_adc

CLOCK_HZ = 80_000_000
CODE_HZ = 8 * CLOCK_HZ / 2**20  # one step of a frequency code: 610.35 Hz
_DIVSET = 20
_CENTRE_CODE = (4 * (_DIVSET + 2) + 8) << 20  # 96 * 640 MHz = 61.44 GHz
_RATE_TOLERANCE = 1e-3
_MIN_PAUSE = 11  # clocks: the shortest timer that is more than one clock
_MAX_EXPONENT = 16  # 5-bit fields; the data sheet calls up to 10 verified, Infineon's own exports go to 13

# What every export has: start-up and guard times, supplies, power-down sets.
_TR_START, _TR_END, _TR_PAEN = 10, 14, 30
_INIT0, _INIT1, _WAKE_UP = (225, 1), (70, 0), (39, 8)
_FIXED: Registers = {
    Register.PACR1: 0xE967FD,
    Register.PACR2: 0x0805B4,
    Register.CSP_I_0: 0,
    Register.CSP_I_1: 0,
    Register.CSP_I_2: 0,
    Register.CSCI: 0x000BE0,
    Register.CSP_D_0: 0,
    Register.CSP_D_1: 0,
    Register.CSP_D_2: 0,
    Register.CSCDS: 0x000B60,
    Register.CS1: 0x000490,
    Register.CS2: 0x000480,
    Register.CS3: 0x000480,
    Register.CS4: 0x000480,
    Register.PLL1_4: 0,
    Register.PLL1_5: 0,
    Register.PLL1_6: 0,
    Register.PLL2_7: 0x000100,
    Register.PLL3_7: 0x000100,
    Register.PLL4_7: 0x000100,
    Register.RFT1: 0,
    Register.SDFT0: 0,
}


@dataclass(frozen=True)
class Timing:
    """One frame in clocks: wake-up, start of the analogue part, then chirps with pauses, then the frame's pause."""

    wake_up: int
    init: int  # T_INIT0 + T_INIT1
    body: int  # one chirp without the pause after it
    chirp: int  # chirp to chirp
    frame: int  # frame to frame
    first_sample: int  # from the chirp's start to the first ADC trigger
    adc_divider: int
    samples: int
    chirps: int

    @property
    def first_chirp(self) -> int:
        """From FRAME_START or the frame's start to its first chirp."""
        return self.wake_up + self.init

    @property
    def last_sample(self) -> int:
        """From the frame's start to the end of its last sample."""
        return self.first_chirp + (self.chirps - 1) * self.chirp + self.chirp_end

    @property
    def chirp_end(self) -> int:
        """From a chirp's start to the end of its last sample."""
        return self.first_sample + self.samples * self.adc_divider

    @property
    def chirp_period_s(self) -> float:
        """From the start of one chirp to that of the next."""
        return self.chirp / CLOCK_HZ

    @property
    def frame_period_s(self) -> float:
        """From the start of one frame to that of the next."""
        return self.frame / CLOCK_HZ

    @property
    def first_chirp_to_end_s(self) -> float:
        """From the start of a frame's first chirp to the end of its last sample."""
        return (self.last_sample - self.first_chirp) / CLOCK_HZ


def register_list(waveform: WaveformConfig) -> Registers:
    """The registers that make the chip send this waveform, without FIFO mark, header and SPI mode (the driver's).

    Raises:
        ConfigError: the chip cannot do that; the text says which key and what is possible.
    """
    if len(waveform.rx) * waveform.samples % 2:
        raise ConfigError("[waveform] samples: even for one or three receivers, because two samples share a FIFO word")
    divider = adc_divider(waveform.sample_rate_hz)
    start_delay = round((waveform.sample_delay_s * CLOCK_HZ - 1) / 8)
    registers = dict(_FIXED)
    registers[Register.MAIN] = 0x1E0000 | _timer(reg.TR_WKUP, reg.TR_WKUP_MUL, _WAKE_UP)
    registers[Register.ADC0] = reg.ADC_DIV.bits(divider) | 0x210
    registers[Register.SFCTL] = reg.QSPI_WT.bits(1) | reg.FIFO_LP_MODE.bits(1)
    registers[Register.SADC_CTRL] = temperature_adc(waveform.samples * divider)
    registers |= receivers(waveform)
    registers |= _ramp(waveform, divider, start_delay)
    registers[Register.CCR0] = (
        reg.TR_END.bits(_TR_END)
        | reg.CONT_MODE.bits(1)
        | reg.REPT.bits(15)
        | _timer(reg.TR_INIT1, reg.TR_INIT1_MUL, _INIT1)
    )
    registers[Register.CCR1] = reg.TR_START.bits(_TR_START) | reg.FRAME_PD_MODE.bits(PdMode.DEEP_SLEEP)
    registers[Register.CCR2] = reg.FRAME_LEN.bits(waveform.chirps - 1)
    registers[Register.CCR3] = (
        reg.TR_PAEN.bits(_TR_PAEN) | reg.TR_SSTART.bits(start_delay) | _timer(reg.TR_INIT0, reg.TR_INIT0_MUL, _INIT0)
    )
    return dict(sorted(_with_pauses(waveform, registers).items()))


def timing_of(registers: Mapping[int, int]) -> Timing:
    """Timing of the programmed waveform (one up-chirp shape).

    After a pause in idle the chip repeats T_INIT0 + T_INIT1, after deep sleep T_WU as well; the last chirp's pause is
    the frame's.
    """
    init = _pause(registers, reg.TR_INIT0, reg.TR_INIT0_MUL) + _pause(registers, reg.TR_INIT1, reg.TR_INIT1_MUL)
    wake_up = _pause(registers, reg.TR_WKUP, reg.TR_WKUP_MUL)
    start = 8 * reg.TR_START.of(registers) + 10
    end_delay = 8 * reg.TR_EDU.of(registers) + 5 if reg.TR_EDU.of(registers) else 2
    ramp = 8 * reg.RTU.of(registers)
    body = start + ramp + 8 * reg.TR_END.of(registers) + 5 + end_delay + _fast_down(registers) + 2
    restart = {PdMode.STAY: 0, PdMode.IDLE: init, PdMode.DEEP_SLEEP: wake_up + init}
    pause = _pause(registers, reg.TR_SED, reg.TR_SED_MUL)
    chirp = body + pause + restart[PdMode(reg.SHAPE_PD_MODE.of(registers))]
    chirps = reg.FRAME_LEN.of(registers) + 1
    frame_pause = _pause(registers, reg.TR_FED, reg.TR_FED_MUL)
    return Timing(
        wake_up=wake_up,
        init=init,
        body=body,
        chirp=chirp,
        frame=wake_up + init + (chirps - 1) * chirp + body + frame_pause,
        first_sample=8 * reg.TR_PAEN.of(registers) + 8 * reg.TR_SSTART.of(registers) + 1,
        adc_divider=reg.ADC_DIV.of(registers),
        samples=reg.APU.of(registers),
        chirps=chirps,
    )


def waveform_of(registers: Mapping[int, int]) -> WaveformConfig:
    """What the chip really does with these registers: the same keys, quantised values.

    The frequencies are those at the moment the transmitter turns on and at the end of the last sample.

    Raises:
        ConfigError: not a waveform of this service (channels with different gains, for example).
    """
    timing = timing_of(registers)
    slope = reg.RSU.signed(registers)
    on = 8 * reg.TR_PAEN.of(registers) - (8 * reg.TR_START.of(registers) + 10)  # transmitter on, after ramp start
    delay = 8 * reg.TR_SSTART.of(registers) + 1
    start_code = reg.FSU.signed(registers) + max(on, 0) * slope
    end_code = start_code + slope * (delay + timing.samples * timing.adc_divider)
    gain_db, cutoff_hz = gain_and_cutoff(registers)
    try:
        return WaveformConfig(
            start_frequency_hz=(_CENTRE_CODE + start_code) * CODE_HZ,
            end_frequency_hz=(_CENTRE_CODE + end_code) * CODE_HZ,
            samples=timing.samples,
            chirps=timing.chirps,
            sample_rate_hz=CLOCK_HZ / timing.adc_divider,
            chirp_period_s=timing.chirp_period_s,
            frame_period_s=timing.frame_period_s,
            rx_mask=reg.BBCH_SEL.of(registers),
            tx_power_level=reg.TX_DAC.of(registers),
            if_gain_db=gain_db,
            hp_cutoff_hz=cutoff_hz,
            sample_delay_s=delay / CLOCK_HZ,
        )
    except ValueError as error:
        raise ConfigError(f"registers: {error}") from None


def adc_divider(sample_rate_hz: float) -> int:
    """80 MHz / rate, 20 to 1023."""
    divider = min(max(round(CLOCK_HZ / sample_rate_hz), 20), 1023)
    got_hz = CLOCK_HZ / divider
    if abs(got_hz - sample_rate_hz) > _RATE_TOLERANCE * sample_rate_hz:
        raise ConfigError(
            f"[waveform] sample_rate_hz = {sample_rate_hz:g}: the chip has 80 MHz / n; next is {got_hz:.1f}"
        )
    return divider


def _ramp(waveform: WaveformConfig, divider: int, start_delay: int) -> Registers:
    """Start code, slope and length; the slope is the nearest that crosses the band while the transmitter is on."""
    low = round(waveform.start_frequency_hz / CODE_HZ) - _CENTRE_CODE
    high = round(waveform.end_frequency_hz / CODE_HZ) - _CENTRE_CODE
    length = waveform.samples * divider + 8 * start_delay + 1
    slope = (2 * (high - low) // length + 1) // 2
    before = 8 * _TR_PAEN - (8 * _TR_START + 10)
    ramp = -(-(length + before) // 8)
    if ramp >= 1 << 14:
        raise ConfigError(f"[waveform] samples = {waveform.samples}: a ramp lasts at most 1.638 ms")
    return {
        Register.PLL1_0: reg.FSU.bits(low - before * slope),
        Register.PLL1_1: reg.RSU.bits(slope),
        Register.PLL1_2: reg.RTU.bits(ramp),
        Register.PLL1_3: reg.APU.bits(waveform.samples),
    }


def _with_pauses(waveform: WaveformConfig, registers: Registers) -> Registers:
    """Fill in the pauses after chirp and frame, in the deepest sleep that leaves time to start again."""
    shape = reg.SH_EN.bits(1) | reg.SHAPE_CONT_MODE.bits(1)
    bare = timing_of(registers | {Register.PLL1_7: shape})
    room = round(waveform.chirp_period_s * CLOCK_HZ) - bare.body
    if room < 1:
        least_us = (bare.body + 1) / CLOCK_HZ * 1e6
        raise ConfigError(f"[waveform] chirp_period_s = {waveform.chirp_period_s:g}: at least {least_us:.3f} us")
    restarts = ((PdMode.DEEP_SLEEP, bare.wake_up + bare.init), (PdMode.IDLE, bare.init), (PdMode.STAY, 0))
    mode, restart = next((m, clocks) for m, clocks in restarts if m == PdMode.STAY or room - clocks >= _MIN_PAUSE)
    shape |= reg.SHAPE_PD_MODE.bits(mode)
    shape |= _timer(reg.TR_SED, reg.TR_SED_MUL, _nearest_timer(room - restart))
    with_shape = registers | {Register.PLL1_7: shape}
    without_pause = timing_of(with_shape).frame - _pause(with_shape, reg.TR_FED, reg.TR_FED_MUL)
    rest = round(waveform.frame_period_s * CLOCK_HZ) - without_pause
    if rest < 1:
        least_ms = (without_pause + 1) / CLOCK_HZ * 1e3
        raise ConfigError(f"[waveform] frame_period_s = {waveform.frame_period_s:g}: at least {least_ms:.4f} ms")
    frame_pause = _timer(reg.TR_FED, reg.TR_FED_MUL, _nearest_timer(rest))
    return with_shape | {Register.CCR1: with_shape[Register.CCR1] | frame_pause}


def _timer(counter: Field, exponent: Field, setting: tuple[int, int]) -> int:
    return counter.bits(setting[0]) | exponent.bits(setting[1])


def _timer_clocks(counter: int, exponent: int) -> int:
    """n * 2^m * 8 + m + 3 clocks; one clock when n is 0."""
    return counter * 8 * 2**exponent + exponent + 3 if counter else 1


def _nearest_timer(clocks: int) -> tuple[int, int]:
    """(counter, exponent) whose time is nearest; the finer step wins a tie."""
    candidates = [(0, 0)]
    for exponent in range(_MAX_EXPONENT + 1):
        counter = round((clocks - exponent - 3) / (8 * 2**exponent))
        candidates += [(counter, exponent)] if 1 <= counter <= 255 else []
    return min(candidates, key=lambda c: (abs(_timer_clocks(*c) - clocks), c[1]))


def _pause(registers: Mapping[int, int], counter: Field, exponent: Field) -> int:
    return _timer_clocks(counter.of(registers), exponent.of(registers))


def _fast_down(registers: Mapping[int, int]) -> int:
    """Clocks of the fast return of the ramp; with timer 0 the mode's own length (500, 700, 300 ns)."""
    mode, timer = reg.FSTDNEN.of(registers), reg.FSDNTMR.of(registers)
    return timer + 1 if mode and timer else {0: 0, 1: 40, 2: 56, 3: 24}[mode]
