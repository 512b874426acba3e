"""Before anything starts: every sensor has a source, and a live site has live ones only. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from common.config import ConfigError, ServiceConfig
from common.host.site import Site
from common.source_url import source_kind
from common.topics import SENSOR_TOPICS

MEASURES = (*SENSOR_TOPICS, "ego")  # services that cannot run without a source
EXAMPLES = {
    "radar": "spi:0.0",
    "lidar": "serial:/dev/ttyTHS1",
    "camera": "v4l2:0",
    "infra_lidar": "velodyne://:2368",
    "ego": "vesc:/dev/ttyACM0",
}
UNKNOWN = "SCHEME:DEVICE"  # a service without an example
ALSO = {"camera": ('set = ["detector.model=/opt/spotter/yolo11n.onnx"]',)}  # the shipped network knows `sim:` alone


def refuse_without_source(host: str, configurations: Mapping[str, ServiceConfig]) -> None:
    """Refuse to start a sensor without a configured source.

    Raises:
        ConfigError: with the lines that are missing in site.toml.
    """
    without = [name for name, config in configurations.items() if name in MEASURES and not config.source]
    if not without:
        return
    lines = [f"[hosts.{host}]"]
    for name in without:
        lines += [f"[hosts.{host}.services.{name}]", f'source = "{EXAMPLES.get(name, UNKNOWN)}"', *ALSO.get(name, ())]
    raise ConfigError(
        f"{host}: no source for {', '.join(without)}: nothing would be measured. Write into site.toml, "
        f"with your devices,\n  " + "\n  ".join(lines) + "\n"
        f"and start with `spotter up {host} --site site.toml`; let `spotter setup {host}` find the "
        "devices and write it; or add --simulated for a simulated world"
    )


def refuse_made_up(site: Site, host: str, configurations: Mapping[str, ServiceConfig]) -> None:
    """Refuse recorded, emulated or simulated sources in a live site.

    Raises:
        ConfigError: names the source and the setting that makes the site one for trials.
    """
    for name, config in configurations.items():
        kind = source_kind(config.source)
        if name in MEASURES and kind != "live" and not site.accept_simulated:
            raise ConfigError(
                f"site: [hosts.{host}.services.{name}] source = {config.source!r}: {kind}, and this site is live; "
                "give the device, or make it a site for trials: accept_simulated = true at the top of site.toml"
            )
