"""The shipped files say what the code says, and impossible waveforms are refused."""

from __future__ import annotations

import tomllib
from pathlib import Path

import msgspec
import pytest

from common.config import ConfigError, load
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


@pytest.mark.parametrize(("mask", "receivers"), [(1, (1,)), (5, (1, 3)), (6, (2, 3)), (7, (1, 2, 3))])
def test_receivers_of_a_mask(mask: int, receivers: tuple[int, ...]) -> None:
    assert WaveformConfig(rx_mask=mask).rx == receivers
