"""The shipped file lists every key with its default; nonsense is refused."""

from __future__ import annotations

import tomllib
from pathlib import Path

import msgspec
import pytest

import services.jetson.lidar.config as config_module
from common.config import ConfigError, load
from services.jetson.lidar.config import LidarConfig

TOML = Path(config_module.__file__).with_name("lidar.toml")


def test_the_shipped_file_is_the_default_and_complete() -> None:
    assert load(LidarConfig, TOML) == LidarConfig()
    document = tomllib.loads(TOML.read_text())

    def keys(mapping: dict, path: str = "") -> set[str]:
        found = set()
        for key, value in mapping.items():
            found |= keys(value, f"{path}{key}.") if isinstance(value, dict) and value else {path + key}
        return found

    assert keys(document) == keys(msgspec.to_builtins(LidarConfig()))


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("zones.imminent_m=2.5", "imminent_m <= caution_m"),
        ("zones.min_points=9", "min_points <= max_points"),
        ("zones.fov=40", "did you mean 'fov_deg'"),
        ("persistence.raise_scans=0", "raise_scans"),
        ("mounting.upside_down=7", "upside_down"),
    ],
)
def test_nonsense_is_refused(override: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        load(LidarConfig, None, [override])
