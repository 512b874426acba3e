"""A source that no service can read is refused at once, with exit code 2: no router is needed to find that out."""

from __future__ import annotations

import importlib

import pytest

from common.config import ConfigError, ServiceConfig, load

SENSORS = {
    "radar": ("services.radar_pi", "RadarConfig"),
    "lidar": ("services.jetson.lidar", "LidarConfig"),
    "camera": ("services.jetson.camera", "CameraConfig"),
    "infra_lidar": ("services.infra_lidar", "InfraLidarConfig"),
    "ego": ("services.jetson.ego", "EgoConfig"),
}
SOURCES = ("", "foo:bar", "sim:crossing?no=1", "sim:nowhere", "mcap:none.mcap")
WRONG = [(sensor, source) for sensor in SENSORS for source in SOURCES]


@pytest.mark.parametrize(("sensor", "source"), [one for one in WRONG if one != ("ego", "mcap:none.mcap")])
def test_a_wrong_source_is_refused_before_a_router_is_waited_for(sensor: str, source: str) -> None:
    package, name = SENSORS[sensor]
    config_type: type[ServiceConfig] = getattr(importlib.import_module(f"{package}.config"), name)
    config = load(config_type, None, [f'source="{source}"', 'zenoh.connect=["tcp/127.0.0.1:1"]'])
    with pytest.raises(ConfigError, match="no source" if not source else "source"):
        importlib.import_module(f"{package}.__main__").run(config)
