"""Waveform <-> registers <-> timing, against exports that Infineon's own tools made."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.config import ConfigError
from services.radar_pi import registers as reg
from services.radar_pi.config import WaveformConfig
from services.radar_pi.exports import mismatches, parse_registers, plan
from services.radar_pi.registers import Register
from services.radar_pi.waveform import CLOCK_HZ, register_list, timing_of, waveform_of

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


@pytest.fixture(params=EXPORTS, name="export")
def _export(request: pytest.FixtureRequest) -> Export:
    return EXPORTS[request.param]


def test_register_list_of_a_readable_waveform_is_the_exported_one_bit_for_bit(export: Export) -> None:
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


def test_timing_of_exported_registers_prints_as_exported(export: Export) -> None:
    timing = timing_of(export.by_address)
    assert np.float32(timing.chirp_period_s) == np.float32(export.printed_chirp)
    assert np.float32(timing.frame_period_s) == np.float32(export.printed_frame)


def test_the_two_published_periods_to_the_last_digit() -> None:
    bench, recorder = (timing_of(EXPORTS[name].by_address) for name in ("3rx_5m", "58_to_63.5_ghz"))
    assert f"{bench.chirp_period_s * 1e3:.7f} ms" == "1.0007125 ms"
    assert f"{bench.frame_period_s * 1e3:.4f} ms" == "100.0074 ms"
    assert f"{recorder.chirp_period_s * 1e6:.3f} us" == "591.125 us"
    assert f"{recorder.frame_period_s * 1e3:.3f} ms" == "77.169 ms"


def test_exported_registers_match_their_settings(export: Export) -> None:
    assert mismatches(export.by_address, export.settings) == []


def test_ramp_of_config_3rx_5m() -> None:
    registers = EXPORTS["3rx_5m"].by_address
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
def test_timing_of_published_headers(words: dict[str, int], chirp_s: float, frame_s: float) -> None:
    timing = timing_of(Export(_5M | words, WaveformConfig(), "", "").by_address)
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


# --- files -----------------------------------------------------------------------------------------------------------


def _register_file(export: Export) -> str:
    return "".join(f"{reg.name_of(a)} 0x{a:04x} 0x{v:08x}\n" for a, v in export.by_address.items())


def _header_file(export: Export) -> str:
    words = ",\n".join(f"    0x{a << 25 | 1 << 24 | v:x}UL" for a, v in export.by_address.items())
    return f"const uint32_t register_list[] = {{\n{words}\n}};\n"


def _fusion_json(s: WaveformConfig) -> str:
    chirp = {
        "type": "chirp", "start_frequency_Hz": s.start_frequency_hz, "end_frequency_Hz": s.end_frequency_hz,
        "num_samples": s.samples, "sample_rate_Hz": s.sample_rate_hz, "rx_mask": s.rx_mask, "tx_mask": 1,
        "tx_power_level": s.tx_power_level, "if_gain_dB": s.if_gain_db, "hp_cutoff_Hz": s.hp_cutoff_hz,
        "lp_cutoff_Hz": s.lp_cutoff_hz,
    }  # fmt: skip
    loop = {"type": "loop", "num_repetitions": s.chirps, "repetition_time_s": s.chirp_period_s, "sequence": [chirp]}
    frame = {"type": "loop", "num_repetitions": 0, "repetition_time_s": s.frame_period_s, "sequence": [loop]}
    return json.dumps({"sequence": [frame]})


def _recorder_json(s: WaveformConfig) -> str:
    shape = {
        "start_frequency_Hz": s.start_frequency_hz, "end_frequency_Hz": s.end_frequency_hz,
        "num_samples_per_chirp": s.samples, "num_chirps_per_frame": s.chirps, "sample_rate_Hz": s.sample_rate_hz,
        "chirp_repetition_time_s": s.chirp_period_s, "frame_repetition_time_s": s.frame_period_s,
        "rx_antennas": list(s.rx), "tx_antennas": [1], "tx_power_level": s.tx_power_level, "if_gain_dB": s.if_gain_db,
        "hp_cutoff_Hz": s.hp_cutoff_hz, "aaf_cutoff_Hz": s.lp_cutoff_hz, "mimo_mode": "off",
    }  # fmt: skip
    return json.dumps({"device_config": {"fmcw_single_shape": shape}})


def _waveform_with(folder: Path, registers: str, settings: str) -> WaveformConfig:
    (folder / "registers.txt").write_text(registers)
    (folder / "settings.json").write_text(settings)
    return WaveformConfig(register_file=str(folder / "registers.txt"), settings_file=str(folder / "settings.json"))


@pytest.mark.parametrize("as_registers", [_register_file, _header_file])
@pytest.mark.parametrize("as_json", [_fusion_json, _recorder_json])
def test_exports_are_loaded_and_win_over_the_keys(export: Export, tmp_path: Path, as_registers, as_json) -> None:
    loaded = plan(_waveform_with(tmp_path, as_registers(export), as_json(export.settings)))
    assert loaded.registers == export.by_address
    assert loaded.waveform.samples == export.settings.samples
    assert loaded.timing.chirps == export.settings.chirps
    assert plan(loaded.waveform) == loaded


def test_settings_alone_are_compiled(export: Export, tmp_path: Path) -> None:
    file = tmp_path / "settings.json"
    file.write_text(_fusion_json(export.settings))
    registers = plan(WaveformConfig(settings_file=str(file))).registers
    assert registers[Register.PLL1_7] == export.by_address[Register.PLL1_7]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("samples", 64), ("chirps", 32), ("rx_mask", 5), ("tx_power_level", 30), ("if_gain_db", 28),
        ("hp_cutoff_hz", 20_000), ("sample_rate_hz", 1e6), ("chirp_period_s", 1.0008e-3), ("frame_period_s", 0.1001),
        ("start_frequency_hz", 58.1e9), ("end_frequency_hz", 60.1e9),
    ],
)  # fmt: skip
def test_files_that_contradict_each_other_are_refused_by_key(tmp_path: Path, key: str, value: float) -> None:
    export = EXPORTS["3rx_5m"]
    other = msgspec.structs.replace(export.settings, **{key: value})
    with pytest.raises(ConfigError, match=rf"does not match .*{key}: settings say {value}, registers say"):
        plan(_waveform_with(tmp_path, _register_file(export), _fusion_json(other)))


@pytest.mark.parametrize("register", ["ADC0", "CS1_U_1", "CS1_U_2", "CCR2", "PLL1_0", "PLL1_1", "PLL1_3", "PLL1_7"])
def test_a_register_list_of_another_minute_is_refused(tmp_path: Path, register: str) -> None:
    export = EXPORTS["3rx_5m"]
    newer = Export(export.registers | {register: EXPORTS["track"].registers[register]}, export.settings, "", "")
    with pytest.raises(ConfigError, match="does not match"):
        plan(_waveform_with(tmp_path, _register_file(newer), _fusion_json(export.settings)))


@pytest.mark.parametrize(
    ("registers", "settings", "text"),
    [
        ("", "{}", "registers missing: MAIN, ADC0"),
        ("MAIN 0x0000 0x001e8270\n", "{}", "registers missing: ADC0"),
        ("MAIN 0x0000 0x011e8270\n", "{}", "no register of this chip: 0x00"),
        ("FIFO 0x0060 0x0\n", "{}", "no register of this chip: 0x60"),
    ],
)
def test_broken_register_files_say_what_is_missing(tmp_path: Path, registers: str, settings: str, text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        parse_registers(registers)


@pytest.mark.parametrize(
    "settings", ["{", "[]", "{}", '{"sequence": []}', '{"sequence": [{"sequence": [{}]}]}', "\xff"]
)
def test_broken_settings_files_are_refused(tmp_path: Path, settings: str) -> None:
    file = tmp_path / "settings.json"
    file.write_text(settings, encoding="latin-1")
    with pytest.raises(ConfigError, match=r"settings\.json"):
        plan(WaveformConfig(settings_file=str(file)))


def test_missing_files_and_a_lonely_register_list_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        plan(WaveformConfig(settings_file=str(tmp_path / "none.json")))
    with pytest.raises(ConfigError, match="register_file needs settings_file"):
        plan(WaveformConfig(register_file=str(tmp_path / "registers.txt")))
