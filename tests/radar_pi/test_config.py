"""The shipped files say what the code says, and impossible waveforms are refused."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from common.config import ConfigError, load
from services.radar_pi.__main__ import app
from services.radar_pi.config import RadarConfig, WaveformConfig

FOLDER = Path(__file__).parents[2] / "services" / "radar_pi"
WITHOUT_A_TOML_VALUE = {"noise_floor_db", "leakage_db"}  # None: shown as a comment


def test_the_shipped_file_holds_every_default() -> None:
    assert load(RadarConfig, FOLDER / "radar.toml") == RadarConfig()


def test_the_shipped_file_lists_every_key() -> None:
    written = tomllib.loads((FOLDER / "radar.toml").read_text())
    for section, defaults in msgspec.to_builtins(RadarConfig()).items():
        if isinstance(defaults, dict):
            assert set(written[section]) >= set(defaults) - WITHOUT_A_TOML_VALUE, section
        else:
            assert section in written


def test_the_bench_configuration_loads() -> None:
    config = load(RadarConfig, FOLDER / "config_3rx_5m.toml")
    assert config.waveform.chirps == 64
    assert config.waveform.hp_cutoff_hz == 80_000


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("waveform.end_frequency_hz=59e9", "has to rise"),
        ("waveform.chirp_period_s=0.0001", "shorter than the time its samples take"),
        ("waveform.frame_period_s=0.01", "shorter than its chirps take"),
        ("waveform.rx_mask=8", "<= 7"),
        ("cfar.treshold_db=3", "did you mean 'threshold_db'"),
        ("cfar.kind=mean", "kind"),
        ("azimuth.left_rx=3", "left_rx and right_rx: both are 3, expected two receivers"),
        ("spi.reset_gpio=25", "reset_gpio and irq_gpio: both are 25, expected two lines"),
    ],
)
def test_impossible_values_are_refused_with_a_reason(override: str, expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        load(RadarConfig, None, [override])


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "range_max_m=0.3",
            "range_max_m = 0.3: expected at least 0.59, 4 range bins of 0.118 m from range_min_m = 0.2",
        ),
        (
            "range_min_m=8",
            "range_min_m = 8.0: expected at most 7.07, 4 range bins of 0.118 m before this waveform's 7.43 m",
        ),
    ],
)
def test_range_limits_that_leave_nothing_to_look_at_are_refused(tmp_path: Path, override: str, message: str) -> None:
    path, (key, _, value) = tmp_path / "radar.toml", override.partition("=")
    path.write_text(f"[processing]\n{key} = {value}\n")
    with pytest.raises(ConfigError, match=re.escape(f"{path}: [processing] {message}")):
        load(RadarConfig, path)
    load(RadarConfig, path, ["source=file:longer.radar"])  # it has a waveform of its own
    for command in ([], ["look"]):
        words = ["--source", "sim:empty", "--set", f"processing.{override}", *command]
        result = CliRunner().invoke(app, words)
        assert (result.exit_code, f"spotter: defaults with --set: [processing] {message}" in result.output) == (2, True)


@pytest.mark.parametrize(("mask", "receivers"), [(1, (1,)), (5, (1, 3)), (6, (2, 3)), (7, (1, 2, 3))])
def test_receivers_of_a_mask(mask: int, receivers: tuple[int, ...]) -> None:
    assert WaveformConfig(rx_mask=mask).rx == receivers
