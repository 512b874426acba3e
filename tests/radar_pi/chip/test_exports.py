"""Files of Infineon's tools: loaded, compiled, and refused when they contradict each other or are broken."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest

from common.config import ConfigError
from services.radar_pi.chip import registers as reg
from services.radar_pi.chip.exports import parse_registers, plan
from services.radar_pi.chip.registers import ADC_DIV, SHAPE_PD_MODE, Field, Register
from services.radar_pi.config import WaveformConfig


def _register_file(export) -> str:
    return "".join(f"{reg.name_of(a)} 0x{a:04x} 0x{v:08x}\n" for a, v in export.by_address.items())


def _header_file(export) -> str:
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
def test_exports_are_loaded_and_win_over_the_keys(export, tmp_path: Path, as_registers, as_json) -> None:
    loaded = plan(_waveform_with(tmp_path, as_registers(export), as_json(export.settings)))
    assert loaded.registers == export.by_address
    assert loaded.waveform.samples == export.settings.samples
    assert loaded.timing.chirps == export.settings.chirps
    assert plan(loaded.waveform) == loaded


def test_settings_alone_are_compiled(export, tmp_path: Path) -> None:
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
def test_files_that_contradict_each_other_are_refused_by_key(exports, tmp_path: Path, key: str, value: float) -> None:
    export = exports["3rx_5m"]
    other = msgspec.structs.replace(export.settings, **{key: value})
    with pytest.raises(ConfigError, match=rf"does not match .*{key}: settings say {value}, registers say"):
        plan(_waveform_with(tmp_path, _register_file(export), _fusion_json(other)))


@pytest.mark.parametrize("register", ["ADC0", "CS1_U_1", "CS1_U_2", "CCR2", "PLL1_0", "PLL1_1", "PLL1_3", "PLL1_7"])
def test_a_register_list_of_another_minute_is_refused(exports, tmp_path: Path, register: str) -> None:
    export = exports["3rx_5m"]
    newer = export.changed({register: exports["track"].registers[register]})
    with pytest.raises(ConfigError, match="does not match"):
        plan(_waveform_with(tmp_path, _register_file(newer), _fusion_json(export.settings)))


@pytest.mark.parametrize(
    ("field", "value", "text"),
    [(ADC_DIV, 0, "divides the clock by 0"), (SHAPE_PD_MODE, 3, "power mode 3 in the pause")],
)
def test_registers_that_make_no_waveform_are_refused(exports, field: Field, value: int, text: str) -> None:
    export = exports["3rx_5m"]
    registers = parse_registers(_register_file(export))
    changed = export.changed({field.register.name: field.put(registers[field.register], value)})
    with pytest.raises(ConfigError, match=text):
        parse_registers(_register_file(changed))


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
