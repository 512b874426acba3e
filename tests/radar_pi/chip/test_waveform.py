"""Waveform <-> registers <-> timing, against exports that Infineon's own tools made."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config import ConfigError
from services.radar_pi.chip import registers as reg
from services.radar_pi.chip.exports import mismatches, plan
from services.radar_pi.chip.registers import Register
from services.radar_pi.chip.waveform import CLOCK_HZ, register_list, timing_of, waveform_of
from services.radar_pi.config import WaveformConfig


def test_register_list_of_a_readable_waveform_is_the_exported_one_bit_for_bit(export) -> None:
    computed = register_list(export.settings)
    expected = export.by_address
    driver_decides = reg.FIFO_CREF.mask  # mark of the FIFO
    assert computed.keys() == expected.keys()
    wrong = {
        reg.name_of(a): f"{computed[a]:06x} != {expected[a]:06x}"
        for a in expected
        if (computed[a] ^ expected[a]) & ~(driver_decides if a == Register.SFCTL else 0)
    }
    assert wrong == {}


def test_timing_of_exported_registers_prints_as_exported(export) -> None:
    timing = timing_of(export.by_address)
    assert np.float32(timing.chirp_period_s) == np.float32(export.printed_chirp)
    assert np.float32(timing.frame_period_s) == np.float32(export.printed_frame)


def test_the_two_published_periods_to_the_last_digit(exports) -> None:
    bench, recorder = (timing_of(exports[name].by_address) for name in ("3rx_5m", "58_to_63.5_ghz"))
    assert f"{bench.chirp_period_s * 1e3:.7f} ms" == "1.0007125 ms"
    assert f"{bench.frame_period_s * 1e3:.4f} ms" == "100.0074 ms"
    assert f"{recorder.chirp_period_s * 1e6:.3f} us" == "591.125 us"
    assert f"{recorder.frame_period_s * 1e3:.3f} ms" == "77.169 ms"


def test_exported_registers_match_their_settings(export) -> None:
    assert mismatches(export.by_address, export.settings) == []


def test_ramp_of_config_3rx_5m(exports) -> None:
    registers = exports["3rx_5m"].by_address
    waveform, timing = waveform_of(registers), timing_of(registers)
    assert waveform.start_frequency_hz == 58.0e9  # transmitter on
    assert waveform.end_frequency_hz == pytest.approx(59.999e9, abs=1e6)
    slope = reg.RSU.of(registers) * 610.3515625 * CLOCK_HZ
    assert slope * 1e-12 == pytest.approx(29.785, abs=1e-3)  # MHz/us
    assert slope * timing.samples * timing.adc_divider / CLOCK_HZ == pytest.approx(1.906e9, abs=1e6)  # sampled
    assert waveform.sample_delay_s == pytest.approx(3.1125e-6)


@pytest.mark.parametrize(
    ("words", "chirp_s", "frame_s"),
    [  # C headers of the configurator: no idle between fast chirps; five seconds per frame
        (
            {"ADC0": 0x088210, "CCR1": 0x3EF40A, "CCR2": 0x00F000, "PLL1_2": 0x252, "PLL1_7": 0x093910},
            6.99625e-5,
            5.0039e-3,
        ),
        (
            {"CCR1": 0x95F40A, "CCR2": 0x01F000, "PLL1_2": 0x532, "PLL1_3": 0x100, "PLL1_7": 0x31FB10},
            5.91112e-4,
            5.00025,
        ),
    ],
    ids=["stay_active", "slow_frames"],
)
def test_timing_of_published_headers(exports, words: dict[str, int], chirp_s: float, frame_s: float) -> None:
    timing = timing_of(exports["3rx_5m"].changed(words).by_address)
    assert timing.chirp_period_s == pytest.approx(chirp_s, abs=0.6e-9)  # six digits, cut off
    assert timing.frame_period_s == pytest.approx(frame_s, rel=2e-6)


def test_the_default_waveform_is_nearly_what_the_chip_does() -> None:
    wanted = WaveformConfig()
    done = plan(wanted).waveform
    assert done.chirp_period_s == pytest.approx(wanted.chirp_period_s, rel=1e-3)
    assert done.frame_period_s == pytest.approx(wanted.frame_period_s, rel=5e-3)
    assert done.sample_rate_hz == wanted.sample_rate_hz
    assert done.end_frequency_hz == pytest.approx(wanted.end_frequency_hz, abs=4e6)


@given(
    st.floats(58.0e9, 61.0e9), st.floats(0.2e9, 2.5e9), st.sampled_from([32, 64, 128, 256]), st.integers(2, 128),
    st.sampled_from([20, 32, 40, 64, 80]), st.floats(0.0, 1e-3), st.floats(0.0, 0.2), st.integers(1, 7),
    st.integers(0, 31), st.sampled_from([18, 23, 33, 48, 30, 45, 60]),
    st.sampled_from([20_000, 45_000, 70_000, 80_000]),
)  # fmt: skip
def test_what_the_chip_does_is_near_what_was_asked(
    start_hz, band_hz, samples, chirps, divider, more_chirp_s, more_frame_s, rx_mask, power, gain_db, cutoff_hz
):
    sampling_s = samples * divider / CLOCK_HZ
    chirp_s = sampling_s + 10e-6 + more_chirp_s
    asked = WaveformConfig(
        start_frequency_hz=start_hz, end_frequency_hz=start_hz + band_hz, samples=samples, chirps=chirps,
        sample_rate_hz=CLOCK_HZ / divider, chirp_period_s=chirp_s,
        frame_period_s=1.02 * chirps * chirp_s + 2e-3 + more_frame_s,
        rx_mask=rx_mask, tx_power_level=power, if_gain_db=gain_db, hp_cutoff_hz=cutoff_hz,
    )  # fmt: skip
    registers = register_list(asked)
    assert all(0 <= value < 1 << 24 for value in registers.values())
    done = waveform_of(registers)
    exact = ("samples", "chirps", "sample_rate_hz", "rx_mask", "tx_power_level", "if_gain_db", "hp_cutoff_hz")
    assert {key: getattr(done, key) for key in exact} == {key: getattr(asked, key) for key in exact}
    assert done.start_frequency_hz == pytest.approx(asked.start_frequency_hz, abs=1300)
    assert done.end_frequency_hz == pytest.approx(asked.end_frequency_hz, abs=305.2 * (samples * divider + 250) + 1300)
    assert done.chirp_period_s == pytest.approx(asked.chirp_period_s, rel=5e-3)
    assert done.frame_period_s == pytest.approx(asked.frame_period_s, rel=5e-3)
    again = waveform_of(register_list(done))  # what the chip does is asked for: nothing moves any more
    assert again.chirp_period_s == done.chirp_period_s
    assert again.start_frequency_hz == done.start_frequency_hz


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"sample_rate_hz": 1.9e6}, "80 MHz / n; next is 1904761.9"),
        ({"if_gain_db": 24}, "the chip has 18, 23 .. 48 and 30, 35 .. 60"),
        ({"lp_cutoff_hz": 400_000}, "lp_cutoff_hz = 400000: the chip's filter is fixed at 500000"),
        ({"samples": 127}, "samples: even for one or three receivers"),
        ({"hp_cutoff_hz": 50_000}, "hp_cutoff_hz = 50000: the chip has"),
        ({"chirp_period_s": 1.06e-4}, "chirp_period_s = 0.000106: at least 110.125 us"),
        ({"frame_period_s": 0.01537}, "frame_period_s = 0.01537: at least"),
        ({"samples": 4094, "chirp_period_s": 4e-3, "frame_period_s": 0.3}, "a ramp lasts at most"),
    ],
)
def test_what_the_chip_cannot_do_is_refused_with_the_reason(change: dict[str, float], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        register_list(msgspec.structs.replace(WaveformConfig(), **change))
