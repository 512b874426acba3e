"""The ego service: configuration, message, simulated motion."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from common.codec import decode, encode
from common.config import ConfigError, load
from common.messages import EgoMotion
from services.jetson.ego import config as ego_config
from services.jetson.ego.config import CanConfig, EgoConfig
from services.jetson.ego.pipeline import EgoPipeline, Motion
from services.jetson.ego.source import open_source
from spotter_sim.world import world_at


def test_the_file_loads_and_equals_the_defaults() -> None:
    assert load(EgoConfig, Path(ego_config.__file__).parent / "ego.toml") == EgoConfig()


def test_the_message_survives_the_wire() -> None:
    pose = np.eye(4)
    pose[0, 3] = 2.5
    message = EgoPipeline(EgoConfig()).process(7, Motion(1.5, -0.1, pose))
    back = decode(encode(message), EgoMotion)
    assert (back.stamp_ns, back.speed_mps, back.yaw_rate_radps) == (7, 1.5, -0.1)
    assert back.T_map_vehicle == pose.tolist()


def test_what_is_unknown_stays_unknown() -> None:
    message = EgoPipeline(EgoConfig(has_pose=False)).process(7, Motion(None, None, np.eye(4)))
    assert (message.speed_mps, message.yaw_rate_radps, message.T_map_vehicle) == (None, None, None)


def test_the_simulated_motion_is_that_of_the_world() -> None:
    source = open_source(EgoConfig(source="sim:crossing?t0=4", rate_hz=200.0))
    (first_ns, first), (second_ns, _) = itertools.islice(source, 2)
    world = world_at("crossing", 4.0)
    assert first.speed_mps == pytest.approx(world.vehicle_speed_mps, abs=0.1)
    assert first.T_map_vehicle is not None
    assert first.T_map_vehicle == pytest.approx(world.T_map_vehicle, abs=0.1)
    assert second_ns > first_ns


@pytest.mark.parametrize(
    ("source", "error_text"),
    [
        ("", "no source: give one"),
        ("sim:nowhere", "no scenario 'nowhere'"),
        ("radio:0", "expected one of can:, gpio:, imu:, ros2:, serial:, sim:, vesc:"),
        ("can:can0", r"\[can\] dbc is missing: expected the file with the bus's signals, e.g. dbc = \"car.dbc\""),
        ("gpio:/dev/gpiochip0", "the line of channel a"),
        ("imu:abacus", "no chip 'abacus'; there are: mpu6050, icm20948, bno055"),
        ("imu:mpu6050?address=high", "is not a number"),
        ("serial:/dev/a + serial:/dev/b", "at most one of each kind"),
        ("sim:empty + imu:bno055", "stands alone"),
    ],
)
def test_a_wrong_source_is_refused_by_name(source: str, error_text: str) -> None:
    with pytest.raises(ConfigError, match=error_text):
        open_source(EgoConfig(source=source))


def test_a_can_bus_without_its_signals_is_refused_with_the_file(tmp_path: Path) -> None:
    file = tmp_path / "ego.toml"
    file.write_text('source = "imu:bno055 + can:can0"\n')
    with pytest.raises(ConfigError, match=r"ego.toml: \[can\] dbc = '': expected the file with the bus's signals"):
        load(EgoConfig, file)


def test_a_can_interface_that_the_library_does_not_have() -> None:
    pytest.importorskip("can")
    can = CanConfig(dbc="car.dbc", interface="socketkan")
    with pytest.raises(ConfigError, match=r"\[can\] interface = 'socketkan': python-can has .*socketcan"):
        open_source(EgoConfig(source="can:can0", can=can))
