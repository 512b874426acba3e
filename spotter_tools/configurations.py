"""Load the configuration of every service of a plan, before the first process starts.

A wrong key then ends the command with one line, instead of half a system that starts and stops again.
"""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module

from common.config import ConfigError, ServiceConfig, load
from common.host.process_plan import Plan, configuration_of
from common.source_url import source_kind
from common.topics import ServiceRow

PACKAGES = {  # of the services that are not the Jetson's
    "radar": "services.radar_pi",
    "infra_lidar": "services.infra_lidar",
    "blackbox": "services.blackbox",
}


def config_type(service: str) -> type[ServiceConfig]:
    """The configuration class of a service: the one that its ``config.py`` defines."""
    package = PACKAGES.get(service, f"services.jetson.{service}")
    module = import_module(f"{package}.config")
    found: type[ServiceConfig]
    (found,) = (one for one in vars(module).values() if _is_config(one) and one.__module__ == module.__name__)
    return found


def _is_config(value: object) -> bool:
    return isinstance(value, type) and issubclass(value, ServiceConfig)


def check_configurations(rows: Iterable[ServiceRow], plan: Plan) -> dict[str, ServiceConfig]:
    """Load what each service will load, by its name; a service with a command of its own is left out.

    Raises:
        ConfigError: names the service, the file or ``--set``, the key, the value and what is allowed.
    """
    loaded: dict[str, ServiceConfig] = {}
    for row in rows:
        if row.name in plan.commands:
            continue
        path, settings = configuration_of(row, plan)
        source = [f'source="{plan.sources[row.name]}"'] if row.name in plan.sources else []
        try:
            loaded[row.name] = load(config_type(row.name), path, [*settings, *source])
            _refuse_unknown_scenario(plan.sources.get(row.name, ""))
        except ConfigError as error:
            raise ConfigError(f"{row.name}: {error}") from None
    return loaded


def _refuse_unknown_scenario(source: str) -> None:
    if source.startswith("sim:"):
        from spotter_sim.world import scenario_named

        try:
            scenario_named(source.removeprefix("sim:").partition("?")[0])
        except ValueError as error:
            raise ConfigError(f"source {source}: {error}") from None


def start_lines(configurations: dict[str, ServiceConfig]) -> list[str]:
    """One line a service: what runs, from which source, where it publishes."""
    width = max(map(len, configurations), default=0)
    return [
        f"{name:<{width}}  {_source_text(config)}publishes {config.zenoh.namespace}/{config.host}/{name}/* "
        f"on {', '.join(config.zenoh.connect)}"
        for name, config in configurations.items()
    ]


def _source_text(config: ServiceConfig) -> str:
    source = getattr(config, "source", "")
    if not source:
        return ""
    kind = source_kind(source)
    return f"source {source}{'' if kind == 'live' else f' ({kind.upper()})'}, "
