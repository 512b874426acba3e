"""The shipped file is the documentation of the defaults."""

from __future__ import annotations

import tomllib
from pathlib import Path

import msgspec
import pytest

from common.config import ConfigError, load
from common.topics import ONBOARD_SENSORS
from services.jetson.fusion import config as fusion_config
from services.jetson.fusion.config import FusionConfig

FILE = Path(fusion_config.__file__).parent / "fusion.toml"


def test_the_file_loads_and_equals_the_defaults() -> None:
    assert load(FusionConfig, FILE) == FusionConfig()


def test_the_file_lists_every_key() -> None:
    written = tomllib.loads(FILE.read_text())
    defaults = msgspec.to_builtins(FusionConfig())

    def keys(table: dict[str, object], prefix: str = "") -> set[str]:
        found = set()
        for key, value in table.items():
            found |= keys(value, f"{prefix}{key}.") if isinstance(value, dict) and value else {prefix + key}
        return found

    assert keys(written) == keys(defaults)


@pytest.mark.parametrize(
    ("setting", "error_text"),
    [
        ("rules.suppression=sometimes", "suppression"),
        ("rules.hold_s=-1", "hold_s"),
        ("health.recovery_frames=0", "recovery_frames"),
        ("health.verdict_period_s=0.2", "verdict_period_s"),
        ("sensors.radar.host=Pi 0", "host"),
        ("roadside.pose=1", "no such key"),
    ],
)
def test_a_wrong_value_is_refused_by_name(setting: str, error_text: str) -> None:
    with pytest.raises(ConfigError, match=error_text):
        load(FusionConfig, None, [setting])


def test_naming_a_sensor_s_host_keeps_its_other_settings(tmp_path: Path) -> None:
    own = FusionConfig().sensors
    by_command_line = load(FusionConfig, None, ["sensors.lidar.host=jetson0", "sensors.camera.host=pi0"]).sensors
    assert (by_command_line.lidar.budget_ms, by_command_line.camera.budget_ms) == (
        own.lidar.budget_ms,
        own.camera.budget_ms,
    )
    file = tmp_path / "fusion.toml"
    file.write_text('[sensors.infra_lidar]\nhost = "infra0"\n[sensors.radar]\nbudget_ms = 90.0\n')
    by_file = load(FusionConfig, file).sensors
    assert by_file.infra_lidar == own.infra_lidar
    assert (by_file.radar.host, by_file.radar.budget_ms) == (own.radar.host, 90.0)


def test_a_vehicle_with_some_of_the_sensors() -> None:
    own = FusionConfig().sensors
    some = own.only(("lidar", "radar"))
    assert (some.lidar, some.radar, some.infra_lidar) == (own.lidar, own.radar, own.infra_lidar)
    assert (some.camera.expected, some.camera.host) == (False, own.camera.host)
    assert own.only(ONBOARD_SENSORS) == own
