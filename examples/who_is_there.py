"""Every service on the bus: since when, which version, how it is.

python examples/who_is_there.py [ENDPOINT]
"""

from __future__ import annotations

import sys
from datetime import UTC, datetime

from spotter_client import ServiceOnBus, connect


def main(endpoint: str = "tcp/127.0.0.1:7447") -> list[ServiceOnBus]:
    """Print and return the services that are on the bus."""
    with connect(endpoint) as bus:
        services = bus.services()
    for service in services:
        since, version = "?", "?"
        if service.info is not None:
            since = datetime.fromtimestamp(service.info.started_ns / 1e9, UTC).strftime("%H:%M:%S")
            version = service.info.version
        name = f"{service.host}/{service.name}"
        sys.stdout.write(f"{name:<24} {version:<8} since {since} UTC  {service.state} {service.reason}\n")
    return services


if __name__ == "__main__":
    try:
        main(*sys.argv[1:2])
    except KeyboardInterrupt:
        pass
    except ConnectionError as error:  # no router answers
        sys.exit(str(error))
