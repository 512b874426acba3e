"""The shipped file lists every key and equals the defaults."""

from pathlib import Path

import msgspec
import pytest

from common.config import ConfigError, load
from services.infra_lidar import config as module
from services.infra_lidar.config import InfraLidarConfig

TOML = Path(module.__file__).with_name("infra_lidar.toml")


def _keys(document: dict, prefix: str = "") -> set[str]:
    found = set()
    for key, value in document.items():
        found |= _keys(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key}
    return found


def test_the_shipped_file_equals_the_defaults_and_lists_every_key():
    import tomllib

    assert load(InfraLidarConfig, TOML) == InfraLidarConfig()
    expected = {k for k in _keys(msgspec.to_builtins(InfraLidarConfig())) if not k.startswith("zenoh.")}
    assert _keys(tomllib.loads(TOML.read_text())) == expected


@pytest.mark.parametrize(
    "setting",
    ["ground.ring_m=0", "clustering.connectivity=6", "T_map_sensor=[1.0, 2.0]", "ground.sectors=3"],
)
def test_wrong_settings_are_refused(setting):
    with pytest.raises(ConfigError):
        load(InfraLidarConfig, None, [setting])


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("classifier.site_model=site_forest", '[classifier] site_model = "site_forest": the name has to end in .npz'),
    ],
)
def test_a_refusal_names_the_key_its_value_and_what_is_allowed(setting, says):
    with pytest.raises(ConfigError) as told:
        load(InfraLidarConfig, None, [setting])
    assert says in str(told.value)
