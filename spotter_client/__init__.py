"""Spotter from a notebook: the newest value, a stream, a question. Typed messages, nothing to configure.

::

    from spotter_client import RadarTracks, connect

    with connect("tcp/127.0.0.1:7447") as bus:
        print(bus.latest("jetson0/fusion/verdict").level)

        for tracks in bus.stream("pi0/radar/tracks", RadarTracks, seconds=10):
            print([(track.range_m, track.ttc_s) for track in tracks.tracks])

        for service in bus.services():
            print(service.host, service.name, service.state, service.reason)

Keys are ``<host>/<service>/<product>``; the README's table lists them with their messages. The examples in
``examples/`` are run by the tests.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from common.config import ConfigError, ZenohConfig
from common.messages import (
    CameraDetections,
    Clusters,
    CompressedImage,
    EgoMotion,
    LaserScan,
    LidarZones,
    Message,
    ObjectTracks,
    PointCloud,
    RadarDetections,
    RadarTracks,
    ServiceInfo,
    ServiceStatus,
    SystemHealth,
    Verdict,
)
from common.security.router import with_certificate
from common.session import close_session, init_zenoh_log, open_session
from spotter_client.bus import Bus, Received, ServiceOnBus

__all__ = [
    "Bus",
    "CameraDetections",
    "Clusters",
    "CompressedImage",
    "ConfigError",
    "EgoMotion",
    "LaserScan",
    "LidarZones",
    "Message",
    "ObjectTracks",
    "PointCloud",
    "RadarDetections",
    "RadarTracks",
    "Received",
    "ServiceInfo",
    "ServiceOnBus",
    "ServiceStatus",
    "SystemHealth",
    "Verdict",
    "connect",
]


@contextmanager
def connect(
    *endpoints: str,
    namespace: str = "spotter",
    certificate: str | Path | None = None,
    give_up_after_s: float = 3.0,
) -> Iterator[Bus]:
    """A client of a router: ``with connect("tcp/192.168.1.20:7447") as bus``. Without an endpoint: this machine's.

    ``certificate`` is for a site with TLS: ``"keys/laptop1.crt"``, its key and ``ca.crt`` beside it.

    Raises:
        ConnectionError: no router answers.
        ConfigError: an endpoint that Zenoh refuses, or a certificate that is not there.
    """
    init_zenoh_log(None)
    config = ZenohConfig(connect=endpoints or ("tcp/127.0.0.1:7447",), namespace=namespace)
    if certificate is not None:
        config = with_certificate(config, Path(certificate).parent, Path(certificate).stem)
    session = open_session(config, give_up_after_s=give_up_after_s)
    try:
        with Bus(session) as bus:
            yield bus
    finally:
        close_session(session)
