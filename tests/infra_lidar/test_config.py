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
    with pytest.raises(ConfigError) as raised:
        load(InfraLidarConfig, None, [setting])
    assert says in str(raised.value)


@pytest.mark.parametrize(
    "pose",
    [
        [1.0] * 16,
        [2.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0],  # scaled
        [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0],  # mirrored
        [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 5.0, 6.0, 7.0, 1.0],  # column by column
        [1.0, 0.0, 0.0, float("inf"), 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
    ],
)
def test_a_pose_that_is_no_rotation_and_translation_is_refused(pose):
    with pytest.raises(ConfigError) as raised:
        load(InfraLidarConfig, None, [f"T_map_sensor={pose}"])
    assert f"--set: T_map_sensor = {pose}: expected a rotation and a translation: " in str(raised.value)


@pytest.mark.parametrize(
    "pose",
    [
        (0.707, -0.707, 0, 8.6, 0.707, 0.707, 0, -8, 0, 0, 1, 5.5, 0, 0, 0, 1),  # three decimals will do
        (1, 0, 0, 400_000.5, 0, 1, 0, 5_600_000.5, 0, 0, 1, 120, 0, 0, 0, 1),
    ],
)
def test_a_surveyed_pose_is_accepted(pose):
    assert InfraLidarConfig(T_map_sensor=pose).T_map_sensor == pose
